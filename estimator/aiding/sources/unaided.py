"""What the attitude without velocity says, while no report comes."""

import numpy as np

from estimator.aiding.covariance import learn
from estimator.aiding.inertial import Prediction
from estimator.aiding.types import SIZE, TURN, AidingParams, Array
from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import rotate
from estimator.types import Vec3


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
