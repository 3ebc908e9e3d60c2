"""Down by the unaided stage, or as another measurement shows it, as the aiding learns it."""

from math import atan2, hypot

import numpy as np

from estimator.aiding.covariance import learn
from estimator.aiding.inertial import Prediction
from estimator.aiding.types import SIZE, TURN, Array
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ACCELERATION_LASTS_S, SPAN_S
from estimator.geometry.quaternion import rotate
from estimator.types import Vec3


@inlined
def observe_unaided(
    now: Prediction,
    gravity_b: Vec3,
    sigma_rad: float,
    tilt_error_rad: float,
    x: Array,
    share: float,
    dt: float,
) -> None:
    """Down by the unaided stage, with the ``share`` that it counts.

    This holds an attitude that velocity has lost. A long acceleration tilts it by
    ``tilt_error_rad``, so it hardly counts in a banked turn.
    """
    noise = sigma_rad**2 * max(1.0, SPAN_S / dt)
    noise = (noise + tilt_error_rad**2 * max(1.0, ACCELERATION_LASTS_S / dt)) / share
    observe_down(now, gravity_b, noise, x)


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
