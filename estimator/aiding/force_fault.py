"""A force that contradicts an attitude which gyroscope and field bear out.

An accelerometer that steps, or wrong velocities, ask for a turn of the attitude as a turn does that
the gyroscope has missed. But such a turn turns the field in G, too, which stands still there
otherwise. If it has stood still, the attitude is taken back to where it was before the force
contradicted it, and the accelerometer's bias is as uncertain as the turn that was asked for.
"""

from typing import NamedTuple

import numpy as np

from estimator.aiding.correction_cusum import MOST_SQUARE
from estimator.aiding.inertial import Prediction, apply_corrections
from estimator.aiding.types import ACC_BIAS, GYR_BIAS, NO_WRONG_FORCE, SIZE, TURN, WrongForce
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ACCELERATION_LASTS_S, FAR, LONG_S, REACH, SPAN_S
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import (
    HALF_TURN_VARIANCE,
    conjugate,
    cross,
    dot,
    log,
    multiply,
    norm,
    rotate,
    square,
    subtract,
)
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3


class Then(NamedTuple):
    """What was known at an earlier moment."""

    q_ned_g: Quaternion = IDENTITY  # G to NED
    gyr_bias_rad_s: Vec3 = ZERO_VEC3  # FRD
    tilt_variance: float = HALF_TURN_VARIANCE  # of the attitude about a level axis, rad^2


class Before(NamedTuple):
    """Attitude and field as they were before the force began to contradict them."""

    then: Then = Then()  # when the window before was opened
    opened: Then = Then()  # when the present one was
    field_g: Vec3 = ZERO_VEC3  # mean direction of the field in G; zero until there is one
    moves: float = LEAST_OFF_RAD**2  # mean square by which the field leaves that, rad^2
    has_skidded: bool = False  # a vehicle with wheels, since something contradicts


@inlined
def follow_field(before: Before, field_g: Vec3, dt: float) -> Before:
    """One more direction of the field, ``dt`` after the last, while nothing contradicts."""
    if square(before.field_g) <= 0.0:
        return before._replace(field_g=field_g)
    moved = min(square(subtract(field_g, before.field_g)), MOST_SQUARE * before.moves)
    mean = approach(before.field_g, field_g, dt / (ACCELERATION_LASTS_S + dt))
    moves = before.moves + dt / (LONG_S + dt) * (moved - before.moves)
    return before._replace(field_g=mean, moves=moves)


@inlined
def is_no_turn(before: Before, field_g: Vec3, q_ned_g: Quaternion, turn_rad: Vec3) -> bool:
    """Whether the field, now in G at ``field_g``, shows that a turn (NED) was not made.

    A turn about the field shows nothing.
    """
    if square(before.field_g) <= 0.0:
        return False
    moved = subtract(field_g, before.field_g)
    left = subtract(moved, cross(field_g, rotate(conjugate(q_ned_g), turn_rad)))
    stands_still = square(moved) < REACH**2 * before.moves
    return stands_still and square(left) - square(moved) > FAR * before.moves


@inlined
def wrong_force(
    before: Before, now: Then, turn_rad: Vec3, field_g: Vec3, place: Vec3
) -> WrongForce:
    """What a force has done and may do that asks for a turn (NED) which was not made.

    Nothing where the field (``field_g``; at the ``place``, NED) fits better by now, and the turn is
    less than has been made and than the bias' change over three windows may explain: then the force
    has mended what a wrong heading had done to attitude and bias.
    """
    back = log(multiply(before.then.q_ned_g, conjugate(now.q_ned_g)))
    bias_back = subtract(before.then.gyr_bias_rad_s, now.gyr_bias_rad_s)
    fits_then = dot(rotate(before.then.q_ned_g, field_g), place)
    fits_now = dot(rotate(now.q_ned_g, field_g), place)
    explained_rad = REACH * 3.0 * SPAN_S * norm(bias_back)
    if fits_now > fits_then and norm(turn_rad) < min(norm(back), explained_rad):
        return NO_WRONG_FORCE
    return WrongForce(
        turn_back_rad=back,
        bias_back_rad_s=bias_back,
        variance=STANDARD_GRAVITY_M_S2**2 * square(turn_rad),
    )


@inlined
def take_back(now: Prediction, found: WrongForce) -> Prediction:
    """What it has done to the attitude undone; the accelerometer's bias as uncertain, in place."""
    x = np.zeros(SIZE)
    for i in range(3):
        x[TURN + i], x[GYR_BIAS + i] = found.turn_back_rad[i], found.bias_back_rad_s[i]
        k = ACC_BIAS + i
        now.covariance[k, k] = max(now.covariance[k, k], found.variance)
    return apply_corrections(now, x)
