"""The paper's signals, prepared once for thousands of runs over them.

What does not depend on the candidate is computed here. With R the estimate,
u_i = R^T v_i^I the estimated and v_i the measured unit vectors:

* sum s_i u_i v_i^T = R^T A with A = sum s_i v_i^I v_i^T; the innovation is
  the vector of its antisymmetric part.
* Tr R~ = Tr(R^T B) with B = sum v_i^I d_i^T, d_i the dual vectors of v_i.

So a step needs R, 3 x 3 products and no normalisation of vectors.
"""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import Recording, simulate
from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.filter.kernel import COLLINEAR_SINE, largest_rate
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY
from estimator.live.settings import Settings, settings_of
from estimator.profile import Profile
from tuning.objective import require_fuzzy_gain

COST_DT_S = 1.0 / COST_RATE_HZ
# J ends at t = 14 s, the signals at 15 s
SCORED_SAMPLES = STEADY.stop

# Columns of one step
TURN = 0  # Omega_m dt, rad (3)
TRUTH = 3  # true attitude (4)
INNOVATION = 7  # A, row by row (9)
TRACE = 16  # B, row by row (9)
FASTEST = 25  # the largest linear rate per unit of K, see ``kernel.largest_rate``
COLUMNS = 26


class PaperSignals(NamedTuple):
    """Steps (S, 1401, 26) of S noise seeds, the columns above, and the first attitude (4,)."""

    steps: Floats
    start: Floats


def paper_signals(profile: Profile, seeds: tuple[int, ...]) -> PaperSignals:
    """The steps of each noise seed, for the profile's confidences and references.

    Raises:
        InputError: the profile is not one of raw vectors, R_hat(0) given, with both confidences
            and the fuzzy gain.
    """
    settings = settings_of(profile)
    _require_raw(settings)
    require_fuzzy_gain(profile)
    steps = [_steps(settings, simulate(seed, COST_SAMPLES)) for seed in seeds]
    return PaperSignals(np.array(steps), np.array(settings.initial))


def _require_raw(settings: Settings) -> None:
    if settings.conditioned:
        raise InputError(
            "base profile: 'sim:' is tuned on raw vectors (conditioning.enabled = false)"
        )
    if settings.initial is None:
        raise InputError("base profile: 'sim:' is tuned from a given filter.initial_attitude")
    if settings.filter.euler_step_max_s < COST_DT_S:
        raise InputError(
            f"base profile: 'sim:' is tuned at steps of {COST_DT_S:g} s, "
            f"filter.euler_step_max_s is {settings.filter.euler_step_max_s:g}"
        )
    for name in ("s_magnetic", "s_gravity"):
        if getattr(settings.reference, name) <= 0.0:
            raise InputError(
                f"base profile: confidence.{name[2:]} is 0; 'sim:' is tuned on both vectors"
            )


def _steps(settings: Settings, recording: Recording) -> Floats:
    kept = slice(0, SCORED_SAMPLES)
    reference = settings.reference
    v1 = _unit(recording.mag_gauss[kept])
    v2 = _unit(-recording.acc_m_s2[kept])
    normal = np.cross(v1, v2)
    sine = np.linalg.norm(normal, axis=1, keepdims=True)
    i1, i2 = np.array(reference.magnetic_ned), np.array(reference.gravity_ned)
    i3 = np.cross(i1, i2)
    inertial_sine = float(np.linalg.norm(i3))
    if min(float(sine.min()), inertial_sine) <= COLLINEAR_SINE:
        raise InputError("base profile: the reference directions are collinear")
    v3 = normal / sine
    i3 /= inertial_sine
    d1, d2 = np.cross(v2, v3) / sine, np.cross(v3, v1) / sine
    weighted = (reference.s_magnetic * i1, reference.s_gravity * i2, reference.s_cross * i3)

    steps = np.empty((SCORED_SAMPLES, COLUMNS))
    steps[:, TURN:TRUTH] = COST_DT_S * recording.gyr_rad_s[kept]
    steps[:, TRUTH:INNOVATION] = recording.q_ned_frd[kept]
    steps[:, INNOVATION:TRACE] = _sum_of_outer(weighted, (v1, v2, v3))
    steps[:, TRACE:FASTEST] = _sum_of_outer((i1, i2, i3), (d1, d2, v3))
    s = (reference.s_magnetic, reference.s_gravity, reference.s_cross)
    steps[:, FASTEST] = [largest_rate(cosine, *s) for cosine in np.sum(v1 * v2, axis=1)]
    return steps


def _sum_of_outer(inertial: tuple[Floats, ...], body: tuple[Floats, ...]) -> Floats:
    """Sum of a b^T for constant a (3,) and b (N, 3), row by row: (N, 9)."""
    total = sum(a[None, :, None] * b[:, None, :] for a, b in zip(inertial, body, strict=True))
    return np.asarray(total).reshape(-1, 9)


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
