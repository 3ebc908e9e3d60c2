"""The paper's filter (docs/paper.md) on many noise seeds and candidates at once, by matrices.

Written apart from the estimator's own, so that one choice at a time can be another one, and the
gain can be set by anything. C candidates on S seeds go through a step together: attitudes are
(C, S, 3, 3), errors and gains (C, S). With every choice as built the errors are those of
``estimator.filter.kernel.run``, which :func:`require_equal` checks.

With R the estimate, u_i = R' v_i^I the estimated and v_i the measured unit vectors, the innovation
is the vector of the antisymmetric part of M = R' A, A = sum s_i v_i^I v_i', and the trace of the
measured error that of R' B, B = sum v_i^I d_i', d_i being the dual vectors of the v_i.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from common.recordings import Array
from scipy.spatial.transform import Rotation

from estimator.filter import kernel
from estimator.geometry.metrics import COST_RATE_HZ, TRANSIENT_WEIGHT
from estimator.geometry.rotations import unit
from estimator.live.settings import Settings, settings_of
from estimator.profile import Profile
from tests.paper_noise import PAPER_NOISE, NoiseScale, simulate_scaled
from tuning.paper_experiment import begun

SIGNED, RECTIFIED, UNFILTERED, NO_RATE = "signed", "rectified", "unfiltered", "none"
PLAIN_STEP_LIMIT, STEP_TOLERANCE = 1.6, 1.1  # of K lambda dt, and of the longest plain step

# K (C, S) from the measured e, its rate (C, S) and the time in s.
Law = Callable[[Array, Array, float], Array]


class Choices(NamedTuple):
    """Which choices differ; the defaults are as built."""

    rate: str = SIGNED
    error_is_true: bool = False  # e for the gain from the truth
    error_is_clipped: bool = True  # to [0, 1], before its derivative
    cross_is_unit: bool = True  # v3 = v1 x v2 normalised, on both sides
    bias_by_step: bool = False  # the bias grows by gamma/2 dt, not by gamma/2 g/K
    step_is_plain: bool = False  # K dt however long the step is


AS_BUILT = Choices()


class Signals(NamedTuple):
    """S seeds of N samples of the paper's signals."""

    rate_hz: float
    gyr_rad_s: Array  # (S, N, 3)
    acc_m_s2: Array
    mag_gauss: Array
    truth: Array  # (S, N, 3, 3), body to NED

    @property
    def vectors(self) -> tuple[Array, Array]:
        """The measured unit vectors, v1 of the field and v2 of gravity, (S, N, 3)."""
        return unit(self.mag_gauss), unit(-self.acc_m_s2)


def signals_of(
    seeds: Iterable[int],
    samples: int,
    noise: NoiseScale = PAPER_NOISE,
    rate_hz: float = 100.0,
) -> Signals:
    """The signals of some seeds, their noise scaled."""
    runs = [simulate_scaled(seed, samples, noise, rate_hz) for seed in seeds]
    gyr, acc, mag = map(np.array, zip(*(run[1:4] for run in runs), strict=True))
    return Signals(rate_hz, gyr, acc, mag, np.array([matrices(run.q_ned_frd) for run in runs]))


def matrices(q: Array) -> Array:
    """Rotation matrices of quaternions (N, 4), w first."""
    return np.asarray(Rotation.from_quat(np.roll(np.atleast_2d(q), -1, axis=1)).as_matrix())


def exponential(phi: Array) -> Array:
    """Rotation matrices of rotation vectors (..., 3)."""
    made = Rotation.from_rotvec(phi.reshape(-1, 3)).as_matrix()
    return np.asarray(made.reshape(*phi.shape, 3))


def errors_of(
    settings: Settings,
    on: Signals,
    law: Law,
    choices: Choices = AS_BUILT,
    start: Array | None = None,
    candidates: int = 1,
) -> Array:
    """The true e (C, S, N) before each correction, from R_hat(0) ``start`` (S or 1, 3, 3)."""
    params, dt = settings.filter, 1.0 / on.rate_hz
    A, B, fastest = prepared(settings, on, choices)
    seeds, n = on.gyr_rad_s.shape[:2]
    start = matrices(np.array(settings.initial)) if start is None else start
    R = np.broadcast_to(start, (candidates, seeds, 3, 3))
    bias, e_before, d = np.zeros((candidates, seeds, 3)), None, np.zeros((candidates, seeds))
    errors = np.empty((candidates, seeds, n))
    step_s = params.first_step_s
    for k in range(n):
        if k > 0:
            step_s = dt
            R = R @ exponential((on.gyr_rad_s[:, k] - bias) * dt)
        true = 0.25 * (3.0 - np.sum(R * on.truth[:, k], axis=(-2, -1)))
        errors[:, :, k] = true
        e = true if choices.error_is_true else 0.25 * (3.0 - np.sum(R * B[:, k], axis=(-2, -1)))
        if choices.error_is_clipped:
            e = np.clip(e, 0.0, 1.0)
        d = rate_of(choices.rate, params.rate_time_constant_s, e, e_before, d, step_s)
        e_before = e
        K = law(e, d, k * dt)
        M = np.swapaxes(R, -1, -2) @ A[:, k]
        w = 0.5 * np.stack(
            [M[..., 1, 2] - M[..., 2, 1], M[..., 2, 0] - M[..., 0, 2], M[..., 0, 1] - M[..., 1, 0]],
            axis=-1,
        )
        g, f = gains_of_step(settings, choices, K, fastest[:, k], step_s)
        R = R @ exponential(-g[..., None] * w)
        bias = np.clip(bias + f[..., None] * w, -params.bias_bound_rad_s, params.bias_bound_rad_s)
    return errors


def prepared(settings: Settings, on: Signals, choices: Choices) -> tuple[Array, Array, Array]:
    """A and B (S, N, 3, 3), and the largest linear rate per unit of K (S, N)."""
    reference = settings.reference
    i1, i2 = np.array(reference.magnetic_ned), np.array(reference.gravity_ned)
    v1, v2 = on.vectors
    i3, v3 = np.cross(i1, i2), np.cross(v1, v2)
    n3, sine = unit(v3), np.linalg.norm(v3, axis=-1, keepdims=True)
    if choices.cross_is_unit:
        i3, v3 = unit(i3), n3
    s1, s2, s3 = reference.s_magnetic, reference.s_gravity, reference.s_cross
    A = s1 * outer(i1, v1) + s2 * outer(i2, v2) + s3 * outer(i3, v3)
    B = outer(i1, np.cross(v2, n3) / sine) + outer(i2, np.cross(n3, v1) / sine)
    B += outer(unit(np.cross(i1, i2)), n3)
    cosine = np.sum(v1 * v2, axis=-1)
    in_plane = 0.5 * (s1 + s2 - np.sqrt((s1 - s2) ** 2 + 4.0 * s1 * s2 * cosine**2))
    smallest = np.minimum(s3, in_plane) if s3 > 0.0 else 0.0 * cosine
    return A, B, 0.5 * (s1 + s2 + s3 - smallest)


def outer(a: Array, b: Array) -> Array:
    """a b' of one vector and many (S, N, 3)."""
    return np.asarray(a[:, None] * b[..., None, :])


def rate_of(kind: str, tau: float, e: Array, before: Array | None, d: Array, dt: float) -> Array:
    """The rate of change of the error, by one of four readings."""
    if before is None or dt <= 0.0 or kind == NO_RATE:
        return d
    slope = (e - before) / dt
    if kind == UNFILTERED:
        return np.asarray(slope)
    return np.asarray(d + dt / (tau + dt) * ((abs(slope) if kind == RECTIFIED else slope) - d))


def gains_of_step(
    settings: Settings, choices: Choices, K: Array, fastest: Array, dt: float
) -> tuple[Array, Array]:
    """What the innovation is multiplied by, for the attitude and for the bias."""
    params, exponent = settings.filter, K * fastest * dt
    plain = (exponent <= PLAIN_STEP_LIMIT) & (dt <= STEP_TOLERANCE * params.euler_step_max_s)
    g = np.where(plain | choices.step_is_plain, K * dt, -np.expm1(-exponent) / fastest)
    if choices.bias_by_step:
        return g, np.full_like(g, 0.5 * params.gamma * dt)
    most = 1.0 / (fastest * dt) if dt > 0.0 else np.inf
    return g, np.minimum(0.5 * params.gamma * g / K, most)


def cost(e: Array, rate_hz: float = COST_RATE_HZ) -> Array:
    """J of Eq. (15) of e (..., N); sums of steps other than 0.01 s are weighted by the step."""
    s = round(rate_hz)
    parts = TRANSIENT_WEIGHT * e[..., : s + 1].sum(-1) + e[..., 4 * s : 14 * s + 1].sum(-1)
    return np.asarray(parts * COST_RATE_HZ / rate_hz)


def kernel_errors(settings: Settings, on: Signals) -> Array:
    """The true e (S, N) of the estimator's own filter, with the gain that its settings have."""
    errors = []
    for s in range(len(on.truth)):
        readings = (on.gyr_rad_s[s], on.acc_m_s2[s], on.mag_gauss[s])
        q, _ = kernel.run(*begun(settings), *readings, 1.0 / on.rate_hz)
        errors.append(0.25 * (3.0 - np.sum(matrices(q) * on.truth[s], axis=(-2, -1))))
    return np.array(errors)


def require_equal(profile: Profile, law: Law) -> None:
    """Stop if the errors with that law are not those of the estimator's own filter."""
    settings, on = settings_of(profile), signals_of(range(2), 300)
    ours, theirs = errors_of(settings, on, law)[0], kernel_errors(settings, on)
    if not np.allclose(ours, theirs, rtol=1e-9, atol=1e-12):
        raise SystemExit(
            f"the filter here is not the estimator's: e differs by {abs(ours - theirs).max():.1e}"
        )
