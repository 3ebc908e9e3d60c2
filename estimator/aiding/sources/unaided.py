"""Down, by the unaided stage or by the force after a missed turn, as the aiding learns it."""

from math import atan2, hypot

import numpy as np

from estimator.aiding.correction_cusum import add_correction, known
from estimator.aiding.covariance import learn, part
from estimator.aiding.inertial import Prediction, apply_corrections
from estimator.aiding.types import SIZE, TURN, Array, CorrectionCusum, StepInputs
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ACCELERATION_LASTS_S, SPAN_S
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import norm, rotate, rotate_inverse, scale, unit
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3


@inlined
def level_by_force(now: Prediction, others: StepInputs) -> Prediction:
    """The tilt corrected by the specific force after a turn that the gyroscope has missed.

    Such a correction is expected. Heading and velocity are left to field and reports.
    """
    P, f = now.covariance, now.force_ned_m_s2
    for i in range(TURN, TURN + 3):
        P[i, i] = max(P[i, i], others.unsensed_turn)
    size = norm(f) / STANDARD_GRAVITY_M_S2 - 1.0
    down_b = rotate_inverse(now.estimate.q_ned_frd, unit(scale(-1.0, f)))
    x = np.zeros(SIZE)
    observe_down(now, down_b, others.force_scatter + size * size + LEAST_OFF_RAD**2, x)
    return apply_corrections(now, x)


@inlined
def level(
    now: Prediction,
    cusum: CorrectionCusum,
    others: StepInputs,
    tilt_error_rad: float,
    share: float,
    dt: float,
) -> tuple[Prediction, CorrectionCusum]:
    """Learn from down by the unaided stage, with the ``share`` that it counts.

    This holds an attitude that velocity has lost. A long acceleration tilts that down by
    ``tilt_error_rad``, so it hardly counts in a banked turn. Large turns do not add up, so this
    correction is applied before the next ones are computed.
    """
    x, before = np.zeros(SIZE), known(now.covariance)
    noise = others.gravity_sigma_rad**2 * max(1.0, SPAN_S / dt)
    noise = (noise + tilt_error_rad**2 * max(1.0, ACCELERATION_LASTS_S / dt)) / share
    observe_down(now, others.gravity_b, noise, x)
    now = apply_corrections(now, x)
    return now, add_correction(cusum, part(x, TURN), before, known(now.covariance))


@inlined
def observe_down(now: Prediction, gravity_b: Vec3, noise: float, x: Array) -> None:
    """Two scalar updates by a measured down in FRD, each of the variance ``noise``, rad^2.

    R_true gravity_b = z gives turn_east = -d_north and turn_north = d_east with d = R gravity_b.
    The distance is a whole turn: upside down is not level.
    """
    P = now.covariance
    d = rotate(now.estimate.q_ned_frd, gravity_b)
    level = hypot(d[0], d[1])
    turn = atan2(level, d[2]) / level if level > 0.0 else 1.0
    h = np.zeros(SIZE)
    h[TURN + 1] = 1.0
    learn(P, x, h, -turn * d[0], noise)
    h[TURN + 1] = 0.0
    h[TURN] = 1.0
    learn(P, x, h, turn * d[1], noise)
