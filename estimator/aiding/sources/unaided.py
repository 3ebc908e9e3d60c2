"""What the stage without velocity says about down, while no report comes or samples are few."""

from math import atan2, hypot

import numpy as np

from estimator.aiding.covariance import learn
from estimator.aiding.inertial import Prediction
from estimator.aiding.types import SIZE, TURN, AidingParams, Array
from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import rotate
from estimator.types import Vec3

# Of slow streams the unaided gravity's error lasts for so long (s), and may be that many sigmas.
SLOW_UNAIDED_TAU_S = 1.0
UNAIDED_DOUBT = 1.5
# An attitude this uncertain is one that velocity has not found, or has lost.
UNKNOWN_TILT_RAD = 0.1


@inlined
def observe_unaided(
    params: AidingParams, now: Prediction, gravity_b: Vec3, x: Array, dt: float
) -> None:
    """Two scalar updates: down by the unaided stage, a weak measurement whose error lasts.

    R_true gravity_b = z gives turn_east = -d_north and turn_north = d_east with d = R gravity_b.
    """
    P = now.covariance
    d = rotate(now.q_ned_frd, gravity_b)
    noise = params.unaided_sigma_rad**2 * params.unaided_tau_s / dt
    h = np.zeros(SIZE)
    h[TURN + 1] = 1.0
    learn(P, x, h, -d[0], noise)
    h[TURN + 1] = 0.0
    h[TURN] = 1.0
    learn(P, x, h, d[1], noise)


@inlined
def observe_slow_unaided(
    now: Prediction, gravity_b: Vec3, sigma_rad: float, x: Array, slow: float, dt: float
) -> None:
    """The same at every step of a slow stream: it holds an attitude that velocity has lost.

    The better velocity knows the attitude, the less this counts: a lasting acceleration
    deceives it. The lean counts as a whole turn, so an attitude that is upside down is not
    taken for a level one.
    """
    P = now.covariance
    d = rotate(now.q_ned_frd, gravity_b)
    lean = hypot(d[0], d[1])
    turn = atan2(lean, d[2]) / lean if lean > 0.0 else 1.0
    known = 0.5 * (P[TURN, TURN] + P[TURN + 1, TURN + 1])
    noise = (UNAIDED_DOUBT * sigma_rad) ** 2 * max(1.0, SLOW_UNAIDED_TAU_S / dt) / slow
    noise *= 1.0 + (UNKNOWN_TILT_RAD**2 / known) ** 2
    h = np.zeros(SIZE)
    h[TURN + 1] = 1.0
    learn(P, x, h, -turn * d[0], noise)
    h[TURN + 1] = 0.0
    h[TURN] = 1.0
    learn(P, x, h, turn * d[1], noise)
