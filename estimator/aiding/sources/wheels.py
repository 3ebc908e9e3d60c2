"""What it says about the attitude that a vehicle rolls forwards or back, but not aside or up."""

from math import atan2, copysign

import numpy as np

from estimator.aiding.covariance import expected_variance, learn, residual, rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.search import UNKNOWN_RAD
from estimator.aiding.sources.velocity import SCALE_REPORTS
from estimator.aiding.types import (
    HARD_IRON,
    SIZE,
    TURN,
    VELOCITY,
    AidingParams,
    Array,
    FieldState,
    Wheels,
)
from estimator.compilation.compiled import inlined
from estimator.conditioning.robust import FAR
from estimator.conditioning.times import ACCELERATION_LASTS_S, BORNE_S, MEMORY_S
from estimator.geometry.quaternion import cross, dot, norm, rotate_inverse
from estimator.types import Vec3

# How far ahead of the axle that does not steer the IMU may sit, m: there a turn is a slip.
ARM_M = 1.0


@inlined
def rolls(params: AidingParams) -> bool:
    """Whether the vehicle's velocity tells its heading."""
    return params.sideslip_rad < 1.0


@inlined
def observe_wheels(
    params: AidingParams, now: Prediction, wheels: Wheels, field: FieldState, x: Array, dt: float
) -> tuple[Wheels, bool]:
    """Two scalar updates: the velocity's parts to the right and down are none but for a slip.

    Whether it goes forwards or back makes no difference. A slip lasts, so the samples of
    ``ACCELERATION_LASTS_S`` together count as one measurement. A mean far beyond any slip tells
    that the heading is not known as well as it seems, nor the field that has told it; so does a
    field that contradicts what wheels have told for long. Also returns whether that is so.
    """
    P, estimate = now.covariance, now.estimate
    v = estimate.velocity_ned_m_s
    body = rotate_inverse(estimate.q_ned_frd, v)
    rolled = params.sideslip_rad**2 * dot(v, v)
    own = rolled + (ARM_M * norm(now.rate_rad_s)) ** 2 + params.filter_noise_m_s**2
    noise = wheels.slip_scale * own * max(1.0, ACCELERATION_LASTS_S / dt)
    share = rolled / own * dt / (MEMORY_S + dt)
    ahead = abs(body[0])
    aside_rad = wheels.aside_rad
    aside_rad += share * (copysign(1.0, body[0]) * atan2(body[1], ahead) - aside_rad)
    is_turned = field.doubt_s > BORNE_S
    if is_turned:
        loosen_iron(P, estimate.earth_gauss, UNKNOWN_RAD)
    if aside_rad * aside_rad > FAR * params.sideslip_rad**2:
        P[TURN + 2, TURN + 2] += aside_rad * aside_rad
        loosen_iron(P, estimate.earth_gauss, aside_rad)
        aside_rad, is_turned = 0.0, True
    R = rotation_matrix(estimate.q_ned_frd)
    square = 0.0
    for k in (1, 2):
        axis = (R[0, k], R[1, k], R[2, k])
        h = np.zeros(SIZE)
        turn = cross(axis, v)
        for i in range(3):
            h[VELOCITY + i] = axis[i]
            h[TURN + i] = turn[i]
        off = -ahead * atan2(body[k], ahead)
        left = residual(x, h, off)
        square += 0.5 * left * left / expected_variance(P, h, own)
        learn(P, x, h, off, noise)
    scale = wheels.slip_scale + share * (min(square, SCALE_REPORTS) - wheels.slip_scale)
    return Wheels(max(1.0, scale), aside_rad, wheels.field_is_turned or is_turned), is_turned


@inlined
def loosen_iron(P: Array, earth_gauss: Vec3, angle_rad: float) -> None:
    """There may be so much iron that it turns the field by an angle, in place."""
    iron = angle_rad * angle_rad * (earth_gauss[0] ** 2 + earth_gauss[1] ** 2)
    for i in range(HARD_IRON, HARD_IRON + 3):
        P[i, i] += iron
