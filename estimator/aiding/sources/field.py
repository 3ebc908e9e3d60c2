"""What a magnetic field sample shows about heading, hard iron, the place's field and its lag."""

from math import atan2, sqrt

import numpy as np

from estimator.aiding.covariance import expected_variance, learn, rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.search import UNKNOWN_RAD
from estimator.aiding.types import (
    COMPASS_TURN,
    EARTH,
    FIELD_LAG,
    HARD_IRON,
    SIZE,
    TURN,
    AidingParams,
    Array,
    FieldState,
    North,
    StepInputs,
)
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import (
    MOST_DISTORTION,
    NORM_SCALE,
    FieldLook,
    horizontal_down,
    look_at_field,
    residual_factor,
)
from estimator.conditioning.params import CONFIRM_S, FIELD_S, LONG_S, REACH
from estimator.conditioning.vertical.bias import SETTLED_HEADING_RAD
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import cross, dot, exp, multiply, norm, rotate, scale, subtract
from estimator.types import ZERO_VEC3, Sample, Vec2, Vec3


@inlined
def begin_anew(state: FieldState) -> FieldState:
    """The place's field is what the next sample shows; what was learnt of it is void."""
    return state._replace(samples=0.0, far_off_s=0.0)


@inlined
def judge_field(
    params: AidingParams, state: FieldState, seen: Vec3, expected: Vec3, variance: float
) -> FieldState:
    """Norm and dip against the place's field, as for the unaided field.

    ``variance`` (of one part of the field, as far as it is learnt) widens both scales.
    """
    wait = min(state.wait_s, 1.0)
    share = wait / (FIELD_S + wait) if state.samples > 0.0 else 1.0
    place = horizontal_down(expected)
    unsure = sqrt(variance) / sqrt(place[0] * place[0] + place[1] * place[1])
    norm_scale, dip_scale = NORM_SCALE + unsure, params.field_dip_scale_rad + unsure
    look = look_at_field(state.look, horizontal_down(seen), share, place, norm_scale, dip_scale)
    return state._replace(look=look, samples=state.samples + 1.0, wait_s=0.0)


@inlined
def begin_field(
    state: FieldState, R: Array, F: Vec3, before: Vec3, north: North, P: Array, x: Array
) -> FieldState:
    """Take the first sample for the place's field, turned towards ``north`` if that is known.

    ``before`` is what was taken for it until then. R turns the compass's axes to NED. The sample
    holds the vehicle's hard iron, so both errors are opposite: d_E = turn x F - A d_iron, whatever
    is known of them. A is R without what points across a known north, which a turn does not change.
    A compass that is turned about its down axis z makes turn - z d_compass of the turn.
    """
    h = sqrt(F[0] * F[0] + F[1] * F[1])
    n = sqrt(h * h + F[2] * F[2])
    if n == 0.0:
        return state
    along = (MOST_DISTORTION * n) ** 2
    A, turned = R.copy(), np.zeros((3, 3))
    if north.is_known:
        (c, s), across = north.direction, (LEAST_OFF_RAD * h) ** 2
        for j in range(3):
            a = c * R[0, j] + s * R[1, j]
            A[0, j], A[1, j] = c * a, s * a
    else:
        (c, s), across = (F[0] / h, F[1] / h) if h > 0.0 else (1.0, 0.0), along
        turned[0, 1], turned[1, 2], turned[2, 0] = F[2], F[0], F[1]
        turned[1, 0], turned[2, 1], turned[0, 2] = -F[2], -F[0], -F[1]
    for j in range(SIZE):
        for i in range(3):
            P[EARTH + i, j] = shown(P, turned, A, R, i, j)
            if not EARTH <= j < EARTH + 3:
                P[j, EARTH + i] = P[EARTH + i, j]
    P[EARTH, EARTH] += along * c * c + across * s * s
    P[EARTH, EARTH + 1] += (along - across) * c * s
    P[EARTH + 1, EARTH] += (along - across) * c * s
    P[EARTH + 1, EARTH + 1] += along * s * s + across * c * c
    P[EARTH + 2, EARTH + 2] += along
    x[EARTH] = h * c - before[0]
    x[EARTH + 1] = h * s - before[1]
    x[EARTH + 2] = F[2] - before[2]
    return FieldState(FieldLook(h, F[2], confidence=1.0), 0.0, 1.0, 0.0, state.far_off_s, 0.0)


@inlined
def compare_with_place(
    params: AidingParams, state: FieldState, seen: Vec3, learnt: Vec3, as_read: Vec3, place: Vec3
) -> FieldState:
    """Whether the place's field explains the readings better than what was learnt of it.

    What is learnt beside a fault of the compass, or with a wrong attitude, need not hold
    afterwards. Strength and dip show that, whatever the heading is. Beyond three sigmas neither is
    an explanation.
    """
    n = norm(place)
    if n == 0.0:
        return state
    wait, most = min(state.wait_s, 1.0), REACH**2 * (NORM_SCALE * n) ** 2
    better = min(most, off_square(seen, learnt)) - min(most, off_square(as_read, place))
    keep = CONFIRM_S / (CONFIRM_S + wait)
    return state._replace(
        evidence=keep * (state.evidence + wait * better / (params.heading_noise * n) ** 2)
    )


@inlined
def off_square(seen: Vec3, expected: Vec3) -> float:
    """Square by which two fields differ along the horizontal and down, whatever their heading."""
    a, b = horizontal_down(seen), horizontal_down(expected)
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2


@inlined
def forget_iron(params: AidingParams, P: Array, x: Array, iron: Vec3) -> None:
    """The hard iron is what calibration has left over, as at the beginning; in place."""
    for i in range(3):
        for j in range(SIZE):
            P[HARD_IRON + i, j] = 0.0
            P[j, HARD_IRON + i] = 0.0
        P[HARD_IRON + i, HARD_IRON + i] = params.hard_iron_sigma_gauss**2
        x[HARD_IRON + i] = -iron[i]


@inlined
def shown(P: Array, turned: Array, A: Array, R: Array, i: int, j: int) -> float:
    """Covariance of one part of (turned (turn - z d_compass) - A d_iron) and another error."""
    total = 0.0
    for k in range(3):
        turn = P[TURN + k, j] - R[k, 2] * P[COMPASS_TURN, j]
        total += turned[i, k] * turn - A[i, k] * P[HARD_IRON + k, j]
    return total


@inlined
def observe_heading(
    params: AidingParams,
    field: FieldState,
    now: Prediction,
    others: StepInputs,
    sample: Sample,
    x: Array,
) -> FieldState:
    """Three scalar updates: the field, turned to NED, is the place's own.

    The reading is ``lag`` old, so it belongs to the attitude then, q exp(-lag w), and to the
    compass's own axes, which may be turned about the body's down. Across the place's horizontal
    field the difference shows the heading and, where the field dips, the tilt. Along it and down it
    shows the tilt across itself, the hard iron and the place's field. A known magnetic north holds
    the direction.
    """
    P, estimate = now.covariance, now.estimate
    rate = subtract(sample.gyr_rad_s, estimate.gyr_bias_rad_s)
    m = subtract(sample.mag, estimate.hard_iron_gauss)
    q_then = multiply(estimate.q_ned_frd, exp(scale(-estimate.field_lag_s, rate)))
    q_compass = multiply(q_then, exp((0.0, 0.0, -estimate.compass_turn_rad)))
    F = rotate(q_compass, m)
    dF = cross(rotate(q_then, rate), F)
    R = rotation_matrix(q_compass)
    north, E = others.north, estimate.earth_gauss
    if field.samples == 0.0:
        return begin_field(field, R, F, ZERO_VEC3, north, P, x)
    wait = min(field.wait_s, 1.0)
    as_read = rotate(q_compass, sample.mag)
    field = compare_with_place(params, field, F, E, as_read, others.place_gauss)
    learnt = P[EARTH + 2, EARTH + 2] + P[HARD_IRON, HARD_IRON]
    field = judge_field(params, field, F, E, learnt)
    if field.evidence > REACH**2:
        forget_iron(params, P, x, estimate.hard_iron_gauss)
        return begin_field(field, R, as_read, E, north, P, x)
    H = sqrt(E[0] * E[0] + E[1] * E[1])
    if NORM_SCALE * abs(E[2]) >= H or wait <= 0.0:
        return field
    c, s = E[0] / H, E[1] / H
    F_along, F_across = c * F[0] + s * F[1], c * F[1] - s * F[0]
    noise = params.heading_noise**2 / (wait * max(field.look.confidence, TINY))
    across = field_row(R, dF, (-s / H, c / H, 0.0), (-c * F[2] / H, -s * F[2] / H, 1.0))
    off = -F_across / H
    angle = atan2(F_across, F_along)
    expected = expected_variance(P, across, 0.0)
    # Either may be wrong: the field, whose error lasts for T and is as noise of 2 T times its
    # variance to a longer average, or the heading, as far as the field looks as usual.
    left = unexplained(params, field.off_rad, expected)
    noise += 2.0 * CONFIRM_S * left / wait
    P[TURN + 2, TURN + 2] += field.look.confidence * left * wait / CONFIRM_S
    noise *= residual_factor(angle, expected)
    is_near = F_along >= 0.5 * abs(F_across)
    # what is linear in the angle does not hold
    if not is_near and P[TURN + 2, TURN + 2] > SETTLED_HEADING_RAD**2:
        across = angle_row(R, F, dF, E)
        off = -angle
    learn(P, x, across, off, noise)
    learn_place(P, x, R, E, F, dF, noise, is_near)
    if north.is_known:
        learn_declination(P, x, E, north.direction, wait)
    far = abs(angle) > UNKNOWN_RAD + 2.0 * sqrt(expected)
    return update_off(field, off, far, wait)


@inlined
def field_row(R: Array, dF: Vec3, axis: Vec3, turn: Vec3) -> Array:
    """How the errors show in (place's field - field seen) on an axis, the attitude's by ``turn``.

    E - F = turn x F - R d_iron - d_lag dF - d_E, all in NED, to which R turns the compass's axes. A
    compass turned in the vehicle shows as the vehicle's turn about minus its down axis.
    """
    h = np.zeros(SIZE)
    for i in range(3):
        for j in range(3):
            h[HARD_IRON + j] -= axis[i] * R[i, j]
        h[EARTH + i] = -axis[i]
        h[TURN + i] = turn[i]
    h[FIELD_LAG] = -dot(axis, dF)
    h[COMPASS_TURN] = -(turn[0] * R[0, 2] + turn[1] * R[1, 2] + turn[2] * R[2, 2])
    return h


@inlined
def angle_row(R: Array, F: Vec3, dF: Vec3, E: Vec3) -> Array:
    """How the errors show in the angle from the field seen to the place's, however large it is."""
    h, H = sqrt(F[0] * F[0] + F[1] * F[1]), sqrt(E[0] * E[0] + E[1] * E[1])
    turn = (-F[0] * F[2] / (h * h), -F[1] * F[2] / (h * h), 1.0)
    row = field_row(R, dF, (-F[1] / (h * h), F[0] / (h * h), 0.0), turn)
    row[EARTH] = E[1] / (H * H)
    row[EARTH + 1] = -E[0] / (H * H)
    return row


@inlined
def learn_place(
    P: Array, x: Array, R: Array, E: Vec3, F: Vec3, dF: Vec3, noise: float, is_near: bool
) -> None:
    """Learn from the horizontal field along itself and from the one down, also about the tilt.

    If the field seen is far from the place's, the turn between them is not small: then the tilt
    only adds to the noise.
    """
    square = dot(E, E)
    n = sqrt(square)
    H = sqrt(E[0] * E[0] + E[1] * E[1])
    along = (E[0] / (H * n), E[1] / (H * n), 0.0)
    down = (0.0, 0.0, 1.0 / n)
    difference = subtract(E, F)
    tilt = 0.0 if is_near else 0.5 * (P[TURN, TURN] + P[TURN + 1, TURN + 1])
    for axis, across in ((along, E[2]), (down, H)):
        turn = cross(F, axis) if is_near else ZERO_VEC3  # axis . (t x F) = t . (F x axis)
        h = field_row(R, dF, axis, turn)
        learn(P, x, h, dot(axis, difference), noise + tilt * across * across / square)


@inlined
def learn_declination(P: Array, x: Array, E: Vec3, north: Vec2, wait: float) -> None:
    """The place's field points to magnetic north, as far as a model is right."""
    c, s = north
    square = E[0] * E[0] + E[1] * E[1]
    h = np.zeros(SIZE)
    h[EARTH] = -E[1] / square
    h[EARTH + 1] = E[0] / square
    off = atan2(s * E[0] - c * E[1], c * E[0] + s * E[1])
    # a declination's error is the same all the time: the samples of LONG_S count as one measurement
    learn(P, x, h, off, LEAST_OFF_RAD**2 * LONG_S / wait)


@inlined
def unexplained(params: AidingParams, off_rad: float, expected: float) -> float:
    """Variance (rad^2) of a constant angle that neither the covariance nor the noise explains.

    The low-pass of ``off_rad``, with T, leaves n / (2 T) of white noise of the density n.
    """
    return max(0.0, off_rad * off_rad - expected - params.heading_noise**2 / (2.0 * CONFIRM_S))


@inlined
def update_off(field: FieldState, off: float, far: bool, wait: float) -> FieldState:
    """Low-pass ``off`` (rad) with ``CONFIRM_S``: noise averages out, a wrong field does not."""
    clipped = max(-MOST_DISTORTION, min(MOST_DISTORTION, off))
    off_rad = field.off_rad + wait / (wait + CONFIRM_S) * (clipped - field.off_rad)
    far_off_s = max(0.0, field.far_off_s - wait)
    if far:  # one that does not look as usual shows nothing about the attitude
        far_off_s = field.far_off_s + wait * field.look.confidence
    return field._replace(off_rad=off_rad, far_off_s=far_off_s)
