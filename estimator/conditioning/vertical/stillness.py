"""Rest: gyroscope and accelerometer stay near their own low-pass. Or is it a slow, even turn?

What a gyroscope at rest shows beyond its known bias is more bias or a turn. In a turn gravity and
field move in the body as the gyroscope shows, at rest they stay. That shows how much of it is a
turn.
"""

from math import sqrt
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import LATELY_S, QUICK_S, REACH, ConditioningParams
from estimator.conditioning.vertical.lowpass import LowPass, Smooth, approach, smooth
from estimator.geometry.quaternion import (
    add,
    cross,
    dot,
    rotate_inverse,
    scale,
    square,
    subtract,
    unit,
)
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec2, Vec3


class RestState(NamedTuple):
    """Whether the vehicle has been quiet for ``rest_time_s``, and whether it rests."""

    gyr: Smooth = Smooth()  # rad/s, FRD
    acc: Smooth = Smooth()  # m/s^2, FRD
    gyr_square: float = 0.0  # how far from it of late, 1 is the limit of quiet
    acc_square: float = 0.0  # the same
    change_square: float = 0.0  # how much a vehicle's low-passed rate changes; from 1 on it turns
    quiet_s: float = 0.0  # for how long both have been near their low-pass
    steady: bool = False  # whether that is long enough for a rest, or for a steady turn
    resting: bool = False  # whether it is a rest


@inlined
def observe_rest(
    params: ConditioningParams, k: LowPass, state: RestState, gyr: Vec3, acc: Vec3, dt_s: float
) -> RestState:
    """Decide whether the vehicle is quiet, and whether it has been for long enough to rest.

    Quiet: the root mean square of a - a_lp under its threshold, that of g - g_lp under the largest
    usual bias; at rest every rate is, too, after VQF (Laidig and Seel 2023, doi
    10.1016/j.inffus.2022.10.014). Comparing with the low-pass before it takes the sample keeps the
    test's meaning at a few samples a second. :func:`watch_stillness` separates a rest from a slow
    steady turn.

    Gravity stands still in the body of a vehicle that its thrust carries, however that tilts. So a
    vehicle's rate shows a bias only where its low-pass stands still: it changes in ``QUICK_S``, or
    in a longer step, by less than a bias that motion teaches is uncertain by.
    """
    limit = params.bias_limit_rad_s
    gyr_smooth = smooth(k, state.gyr, gyr)
    g = gyr_smooth.value
    gyr_off = square(subtract(gyr, state.gyr.value)) / (limit * limit)
    changed = square(subtract(g, state.gyr.value)) * max(1.0, QUICK_S / dt_s) ** 2
    change = changed / (3.0 * params.bias_motion_sigma_rad_s**2) if params.in_vehicle else 0.0
    acc_off = square(subtract(acc, state.acc.value)) / params.rest_acc_m_s2**2
    share = dt_s / (QUICK_S + dt_s)
    gyr_square = state.gyr_square + share * (min(gyr_off, REACH) - state.gyr_square)
    acc_square = state.acc_square + share * (min(acc_off, REACH) - state.acc_square)
    change_square = state.change_square + share * (min(change, REACH) - state.change_square)
    slow = abs(g[0]) < limit and abs(g[1]) < limit and abs(g[2]) < limit
    quiet_s = min(state.quiet_s + dt_s, 1e6) if gyr_square < 1.0 and acc_square < 1.0 else 0.0
    steady = quiet_s >= params.rest_time_s
    return RestState(
        gyr=gyr_smooth,
        acc=smooth(k, state.acc, acc),
        gyr_square=gyr_square,
        acc_square=acc_square,
        change_square=change_square,
        quiet_s=quiet_s,
        steady=steady,
        resting=steady and slow,
    )


# What calibrations leave of a direction's error, rad, of gravity and of the field.
LEAST_DIRECTION_RAD = 0.005
# By how much (rad) noise and an uneven field turn the vectors while they are compared.
STILL_RAD = 0.004
# A share of two undoes a bias that was taken from a turn.
MOST_TURNING = 2.0


class Stillness(NamedTuple):
    """What gravity and field show of a vehicle that seems to rest.

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
    proven: bool = False  # whether both stand still, and show it of every axis
    contradicted: bool = False  # gravity turns in the body as no gyroscope shows it


NOT_STEADY = Stillness()


@inlined
def watch_stillness(
    params: ConditioningParams, before: Stillness, rest: RestState, rate: Vec3, mean: Gathered
) -> Stillness:
    """The state after a step with a low-passed ``rate`` (less the bias, FRD) and a mean field.

    The field is low-passed as both other sensors are. In a banked turn the force stands still in
    the body, and the field does not.
    """
    dt_s, down = mean.time_s, unit(rest.acc.value)
    smooth, mean_field, wait_s = before.field, before.mean_field, before.wait_s + dt_s
    if mean.field_s > 0.0:
        field = rotate_inverse(mean.q_g_frd, mean.field_g)
        smooth = approach(smooth, field, wait_s / (QUICK_S + wait_s))
        mean_field = mean_after(mean_field, unit(smooth), rate, wait_s)
        wait_s = 0.0
    if not rest.steady:
        return NOT_STEADY._replace(
            field=smooth, wait_s=wait_s, mean_field=unit(smooth), mean_down=down
        )
    mean_down = mean_after(before.mean_down, down, rate, dt_s)
    shown = scale(LATELY_S / (LATELY_S + dt_s), add(before.shown, scale(dt_s, rate)))
    seen_field = unit(smooth) if wait_s <= params.rest_time_s else ZERO_VEC3
    unexpected, about_down = turn_between(mean_down, down, mean_field, seen_field)
    # about down, and about the level axes, of which gravity shows all
    shown_down, rate_down = dot(shown, down), dot(rate, down)
    shown_level = subtract(shown, scale(shown_down, down))
    rate_level = subtract(rate, scale(rate_down, down))
    seen_level = add(shown_level, subtract(unexpected, scale(dot(unexpected, down), down)))
    level, level_variance = turn_of_level(shown_level, seen_level, rate_level)
    seen_down = shown_down + dot(unexpected, down)
    turn, down_variance = turn_of_down(shown_down, seen_down, rate_down, about_down)
    # an accelerometer that drifts shows what no turn explains
    shown_rad, seen_rad = sqrt(square(shown_level)), sqrt(square(seen_level))
    contradicted = seen_rad > MOST_TURNING * shown_rad + REACH * STILL_RAD
    left = subtract(subtract(seen_field, mean_field), cross(seen_field, unexpected))
    proven = (
        square(left) < (REACH * STILL_RAD) ** 2
        and is_within(sqrt(square(level)), level_variance, params.bias_limit_rad_s)
        and (
            is_within(turn, down_variance, params.bias_limit_rad_s)
            or is_poor(params, rest.acc.value, rate_down, subtract(rate_level, level))
        )
    )
    return Stillness(
        field=smooth,
        wait_s=wait_s,
        mean_field=mean_field,
        mean_down=mean_down,
        shown=shown,
        turning=add(level, scale(turn, down)),
        level_variance=level_variance,
        down_variance=down_variance,
        proven=proven and not contradicted,
        contradicted=contradicted,
    )


@inlined
def is_poor(params: ConditioningParams, acc: Vec3, rate_down: float, wrong_level: Vec3) -> bool:
    """Whether the gyroscope is so poor that its rate about down (rad/s) may be none.

    One that errs by ``wrong_level`` about level axes may err as much about down. But in a banked
    turn, where gravity seems to show that, an accelerometer feels more than gravity.
    """
    beyond = abs(sqrt(square(acc)) - STANDARD_GRAVITY_M_S2)
    most = max(params.bias_limit_rad_s, sqrt(square(wrong_level)))
    return beyond < params.rest_acc_m_s2 and abs(rate_down) < most


@inlined
def is_within(value: float, variance: float, limit: float) -> bool:
    """Whether a value is surely no larger than a limit."""
    return abs(value) + REACH * sqrt(variance) < limit


@inlined
def mean_after(mean: Vec3, v: Vec3, rate: Vec3, dt_s: float) -> Vec3:
    """The mean of a direction, turned as a body does that turns at ``rate``, with ``v``."""
    turned = subtract(mean, scale(dt_s, cross(rate, mean)))
    return approach(turned, v, dt_s / (LATELY_S + dt_s))


@inlined
def turn_between(mean_down: Vec3, down: Vec3, mean_field: Vec3, field: Vec3) -> tuple[Vec3, float]:
    """The small turn (rad) that takes the means to the directions, and its variance about down.

    A turn phi changes a direction v by v x phi. Gravity shows phi except about down. The field
    shows that part, the worse the steeper it is, and without a field it may be anything.
    """
    level = cross(subtract(down, mean_down), down)
    across = cross(field, down)
    size = square(across)
    if size <= 0.0:
        return level, 1.0
    left = subtract(subtract(field, mean_field), cross(field, level))
    return add(level, scale(dot(left, across) / size, down)), STILL_RAD**2 / size


@inlined
def turn_of_down(shown: float, seen: float, rate: float, variance: float) -> Vec2:
    """The rate about down at which the body turns, and its variance.

    ``seen`` is the turn (rad, of that ``variance``) during the time in which the gyroscope, at
    ``rate`` beyond its bias, showed ``shown``. The share of the rate that the vectors confirm has a
    prior of 0 +- 1.
    """
    noise = STILL_RAD**2 + variance
    whole = shown * shown + noise
    turning = max(0.0, min(MOST_TURNING, shown * seen / whole)) * rate
    return turning, rate * rate * noise / whole


@inlined
def turn_of_level(shown: Vec3, seen: Vec3, rate: Vec3) -> tuple[Vec3, float]:
    """The rate about level axes at which the body turns, and its variance about each.

    As :func:`turn_of_down` has it; the prior of the turn is as large as ``rate``.
    """
    whole = square(shown) + STILL_RAD**2
    size = square(rate)
    turning = scale(sqrt(square(shown) * size) / whole, seen)
    most = MOST_TURNING * sqrt(size)
    turned = sqrt(square(turning))
    if turned > most:
        turning = scale(most / turned, turning)
    return turning, size * STILL_RAD**2 / whole
