"""Whether what looks like rest is a slow, even turn: gravity and field stand still in the body.

What a gyroscope at rest shows beyond its known bias is either more bias, or a turn. In a turn
gravity and the field move in the body as the gyroscope says, at rest they stay. So they tell how
much of it is a turn, and how well that is known.
"""

from math import sqrt
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.robust import REACH
from estimator.conditioning.times import LATELY_S, QUICK_S
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.rest import RestState
from estimator.geometry.quaternion import add, cross, dot, scale, square, subtract, unit
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec2, Vec3

# What calibrations leave of a direction's error, rad, of gravity and of the field.
LEAST_DIRECTION_RAD = 0.005
# By how much (rad) noise and a bent field turn the vectors while they are compared.
STILL_RAD = 0.004
# A share of two undoes a bias that was taken from a turn.
MOST_TURNING = 2.0


class Stillness(NamedTuple):
    """What gravity and field say of a vehicle that seems to rest.

    The means are of ``LATELY_S``, turned in the body as they should be if the known bias is right.
    """

    field: Vec3 = ZERO_VEC3  # low-passed, in its own unit, FRD
    wait_s: float = 0.0  # since the last sample of it
    mean_field: Vec3 = ZERO_VEC3  # of its direction, FRD
    mean_down: Vec3 = ZERO_VEC3  # of gravity's direction, FRD
    shown: Vec3 = ZERO_VEC3  # turn since then, if the known bias is right, rad, FRD
    turning: Vec3 = ZERO_VEC3  # the turn that there is now, rad/s, FRD
    level_variance: float = 0.0  # of that about each level axis, (rad/s)^2
    down_variance: float = 0.0  # of that about down, (rad/s)^2
    proven: bool = False  # whether both stand still, and tell it of every axis


@inlined
def direction(v: Vec3) -> Vec3:
    """The unit vector along ``v``; zero if that is."""
    return unit(v) if square(v) > 0.0 else v


@inlined
def watch_stillness(
    params: ConditioningParams,
    before: Stillness,
    rest: RestState,
    rate: Vec3,
    field: Vec3,
    has_field: bool,
    dt_s: float,
) -> Stillness:
    """The state after a step with a low-passed ``rate`` (less the bias) and a ``field``, in FRD.

    The field is low-passed as gyroscope and accelerometer are. In a banked turn the force stands
    still in the body, and the field does not.
    """
    smooth, mean_field, wait_s = before.field, before.mean_field, before.wait_s + dt_s
    down = direction(rest.acc.value)
    if has_field:
        smooth = approach(smooth, field, wait_s / (QUICK_S + wait_s))
        mean_field = mean_after(mean_field, direction(smooth), rate, wait_s)
        wait_s = 0.0
    if not rest.steady:
        zero = ZERO_VEC3
        return Stillness(smooth, wait_s, direction(smooth), down, zero, zero, 0.0, 0.0, False)
    mean_down = mean_after(before.mean_down, down, rate, dt_s)
    shown = scale(LATELY_S / (LATELY_S + dt_s), add(before.shown, scale(dt_s, rate)))
    seen_field = direction(smooth) if wait_s <= params.rest_time_s else ZERO_VEC3
    unexpected, about_down = turn_between(mean_down, down, mean_field, seen_field)
    # about down, and about the axis across it about which the gyroscope shows a turn
    shown_down, rate_down = dot(shown, down), dot(rate, down)
    shown_level = subtract(shown, scale(shown_down, down))
    rate_level = subtract(rate, scale(rate_down, down))
    shown_size, rate_size = sqrt(square(shown_level)), sqrt(square(rate_level))
    seen_level = shown_size + dot(unexpected, direction(shown_level))
    level, level_variance = turn_of_axis(shown_size, seen_level, 0.0, rate_size)
    seen_down = shown_down + dot(unexpected, down)
    turn, down_variance = turn_of_axis(shown_down, seen_down, about_down, rate_down)
    left = subtract(subtract(seen_field, mean_field), cross(seen_field, unexpected))
    limit = params.bias_limit_rad_s
    # a gyroscope that errs by more about level axes may err by as much about down
    # and in a banked turn an accelerometer feels more than gravity
    beyond = abs(sqrt(square(rest.acc.value)) - STANDARD_GRAVITY_M_S2)
    is_poor = beyond < params.rest_acc_m_s2 and abs(rate_down) < max(limit, rate_size - abs(level))
    proven = (
        square(left) < (REACH * STILL_RAD) ** 2
        and is_within(level, level_variance, limit)
        and (is_within(turn, down_variance, limit) or is_poor)
    )
    turning = add(scale(level, direction(rate_level)), scale(turn, down))
    return Stillness(
        smooth,
        wait_s,
        mean_field,
        mean_down,
        shown,
        turning,
        level_variance,
        down_variance,
        proven,
    )


@inlined
def is_within(value: float, variance: float, limit: float) -> bool:
    """Whether a value can be told to be no larger than a limit."""
    return abs(value) + REACH * sqrt(variance) < limit


@inlined
def mean_after(mean: Vec3, v: Vec3, rate: Vec3, dt_s: float) -> Vec3:
    """The mean of a direction, turned as a body does that turns at ``rate``, with ``v``."""
    turned = subtract(mean, scale(dt_s, cross(rate, mean)))
    return approach(turned, v, dt_s / (LATELY_S + dt_s))


@inlined
def turn_between(mean_down: Vec3, down: Vec3, mean_field: Vec3, field: Vec3) -> tuple[Vec3, float]:
    """The small turn (rad) that takes the means to the directions, and its variance about down.

    A turn phi changes a direction v by v x phi. Gravity tells phi but about down, which the
    field tells, the worse the steeper it is: without one it may be anything.
    """
    level = cross(subtract(down, mean_down), down)
    across = cross(field, down)
    size = square(across)
    if size <= 0.0:
        return level, 1.0
    left = subtract(subtract(field, mean_field), cross(field, level))
    return add(level, scale(dot(left, across) / size, down)), STILL_RAD**2 / size


@inlined
def turn_of_axis(shown: float, seen: float, unseen: float, rate: float) -> Vec2:
    """The rate about an axis at which the body turns, and its variance.

    The turn is a share of the ``rate`` that the gyroscope shows beyond its bias, the share that
    ``seen`` is of ``shown``, with a prior of 0 +- 1. ``unseen`` (rad^2) is the variance of what the
    vectors leave open about that axis.
    """
    noise = STILL_RAD**2 + unseen
    whole = shown * shown + noise
    share = max(0.0, min(MOST_TURNING, shown * seen / whole))
    return share * rate, rate * rate * noise / whole
