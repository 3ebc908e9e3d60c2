"""The attitude of a vehicle that rolls forwards or back, but neither sideways nor up."""

from math import atan2

import numpy as np

from estimator.aiding.covariance import expected_variance, learn, residual, rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.sources.velocity import SCALE_REPORTS
from estimator.aiding.types import EARTH, SIZE, TURN, VELOCITY, AidingParams, Array, North, Wheels
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ACCELERATION_LASTS_S, FAR, MEMORY_S, REACH
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import cross, dot, norm, rotate_inverse

# How far ahead of the axle that does not steer the IMU may sit, m: there a turn is a slip.
ARM_M = 1.0


@inlined
def rolls(params: AidingParams) -> bool:
    """Whether the vehicle's velocity shows its heading."""
    return params.sideslip_rad < 1.0


@inlined
def observe_wheels(
    params: AidingParams, now: Prediction, wheels: Wheels, x: Array, dt: float
) -> Wheels:
    """Two scalar updates: apart from a slip, the velocity has no part to the right or down.

    It may go forwards or back. A slip lasts, so the samples of ``ACCELERATION_LASTS_S`` together
    count as one measurement. If the first one is far beyond any slip, the first heading was wrong.
    """
    P, estimate = now.covariance, now.estimate
    v = estimate.velocity_ned_m_s
    body = rotate_inverse(estimate.q_ned_frd, v)
    rolled = params.sideslip_rad**2 * dot(v, v)
    own = rolled + (ARM_M * norm(now.rate_rad_s)) ** 2 + params.filter_noise_m_s**2
    noise = wheels.slip_scale * own * max(1.0, ACCELERATION_LASTS_S / dt)
    share = rolled / own * dt / (MEMORY_S + dt)
    ahead = abs(body[0])
    R = rotation_matrix(estimate.q_ned_frd)
    square, sideways = 0.0, 0.0
    for k in (1, 2):
        axis = (R[0, k], R[1, k], R[2, k])
        h = np.zeros(SIZE)
        turn = cross(axis, v)
        for i in range(3):
            h[VELOCITY + i] = axis[i]
            h[TURN + i] = turn[i]
        off = -ahead * atan2(body[k], ahead)
        left = residual(x, h, off)
        unlikely = left * left / expected_variance(P, h, own)
        square += 0.5 * unlikely
        if k == 1:
            sideways = unlikely
        learn(P, x, h, off, noise)
    scale = wheels.slip_scale + share * (min(square, SCALE_REPORTS) - wheels.slip_scale)
    is_first = wheels.rolled_s < ACCELERATION_LASTS_S
    rolled_s = wheels.rolled_s + dt * rolled / own
    return Wheels(max(1.0, scale), rolled_s, is_first and sideways > FAR, wheels.show_north)


@inlined
def judge_north(wheels: Wheels, now: Prediction, north: North) -> Wheels:
    """Whether velocity has shown that the field points to magnetic north.

    Iron all around turns a field about the vertical and keeps its strength and dip. There is none
    if the learnt field of the place is known well enough across and points north.
    """
    if not north.is_known:
        return wheels
    shown = field_variance(now) <= REACH**2 * LEAST_OFF_RAD**2 and not is_turned(now, north)
    return wheels._replace(show_north=shown)


@inlined
def field_variance(now: Prediction) -> float:
    """Variance (rad^2) of the direction of the place's horizontal field, as learnt."""
    P, E = now.covariance, now.estimate.earth_gauss
    i, j, square = EARTH, EARTH + 1, max(E[0] * E[0] + E[1] * E[1], TINY)
    known: float = E[1] * E[1] * P[i, i] - 2.0 * E[0] * E[1] * P[i, j] + E[0] * E[0] * P[j, j]
    return known / (square * square)


@inlined
def is_turned(now: Prediction, north: North) -> bool:
    """Whether that points elsewhere than to magnetic north, as far as both are known."""
    E, (c, s) = now.estimate.earth_gauss, north.direction
    off = atan2(s * E[0] - c * E[1], c * E[0] + s * E[1])
    return off * off > REACH**2 * (field_variance(now) + LEAST_OFF_RAD**2)
