"""Body rates of another message, which show the turning between two IMU samples.

An autopilot's ATTITUDE carries the rates of its own gyroscope, less the bias it has learnt.
Where it comes at other instants than the IMU's samples, the turn over a step is integrated
through all of them. Where it comes with the samples, nothing is between and nothing changes, but
for an axis of the gyroscope that field and force contradict. There the rates replace it, if they
agree with the samples about the other axes.

The rates that wait for a sample are rows of an array: time (us) and rate (rad/s). ``handle`` is one
of :mod:`estimator.live.kernel_handle`.
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import SPAN_S
from estimator.conditioning.rate import integration_rate
from estimator.conditioning.vertical.lowpass import approach
from estimator.geometry.quaternion import add, exp, log, multiply, norm, scale, subtract
from estimator.live.rows import enqueue
from estimator.types import (
    IDENTITY,
    NEVER_US,
    NOTHING_BETWEEN,
    UNSEEN_STEP_S,
    ZERO_VEC3,
    Between,
    Vec3,
)

# Arrays of float64.
Rates = Any

# More rates than this are not kept: 5 s of 50 a second; a longer hole stays one.
MOST_WAITING = 256
COLUMNS = 4
# A rate this near an IMU sample (s) is the sample's own. Of short steps it is that share of the
# step, so that a rate half-way between two samples 40 ms apart counts, but no less than messages
# of one moment are apart.
SAME_INSTANT_S = 0.03
SAME_INSTANT = 0.15
ONE_MOMENT_S = 0.012
# The samples' bias against the rates is their mean difference over this time (s), at most rad/s.
OFFSET_TAU_S = 20.0
MOST_OFFSET_RAD_S = 0.1
# Rates and samples agree while their difference has less than this share of the turning's
# mean square; both are averages over so many seconds. Slower turning than this proves nothing.
MOST_MISFIT = 0.5
AGREEMENT_TAU_S = 20.0
LEAST_TURNING_RAD_S = 0.05
LEAST_COMPARED_S = 0.5

Axes = tuple[bool, bool, bool]
NO_AXES: Axes = (False, False, False)


class Turning(NamedTuple):
    """What is known of the rates since the last IMU sample, and how well both have agreed."""

    before_us: int = NEVER_US  # of the last one that a sample has passed
    before_rad_s: Vec3 = ZERO_VEC3
    last_gyr_rad_s: Vec3 = ZERO_VEC3
    offset_rad_s: Vec3 = ZERO_VEC3  # samples less rates
    misfit: Vec3 = ZERO_VEC3  # mean squares of the difference, (rad/s)^2
    turning: Vec3 = ZERO_VEC3  # mean squares of the samples' rate, (rad/s)^2
    compared_s: float = 0.0  # for how long both have been compared
    used: int = 0  # steps that were integrated through rates
    stands_in: Axes = NO_AXES  # where the rates replace the samples


STILL = Turning()  # before any rate


@inlined
def has_rates(handle: Any) -> bool:
    """Whether there has been any rate."""
    return len(handle.rates) > 0 or handle.turning.before_us != NEVER_US


@inlined
def agrees(state: Turning, but: Axes) -> bool:
    """Whether the rates show what the samples show, as far as there was anything to show.

    All axes count ``but`` those.
    """
    misfit, turning = 0.0, 0.0
    for axis in range(3):
        if not but[axis]:
            misfit += state.misfit[axis]
            turning += state.turning[axis]
    return misfit <= MOST_MISFIT * max(turning, LEAST_TURNING_RAD_S * LEAST_TURNING_RAD_S)


@inlined
def contradicted_axes(handle: Any) -> tuple[bool, bool, bool]:
    """Whether field and force contradict the gyroscope's axes x, y, z now.

    By more than a bias that the profile allows: such an error is not learnt.
    """
    axes = handle.conditioning.events.axes
    is_now = axes.since_s < SPAN_S
    least = handle.params.conditioning.bias_limit_rad_s**2
    x, y, z = axes.squares
    common = min(x, y, z)  # of a field that contradicts all three it is the field's own
    x, y, z = x - common, y - common, z - common
    return is_now and x > least, is_now and y > least, is_now and z > least


@inlined
def keep_rate(handle: Any, time_us: int, rate_rad_s: Vec3) -> None:
    """Keep body rates, unless they come too late or are not later than the last.

    Those at the times of the samples are of use only where an axis is contradicted.
    """
    state, rates = handle.turning, handle.rates
    is_kept = time_us > handle.time_us
    if time_us == handle.time_us:
        a, b, c = contradicted_axes(handle)
        d, e, f = state.stands_in
        is_kept = a or b or c or d or e or f
    if is_kept and time_us > (state.before_us if len(rates) == 0 else rates[-1, 0]):
        x, y, z = rate_rad_s
        handle.rates = enqueue(rates, np.array((float(time_us), x, y, z)), MOST_WAITING)


@inlined
def rate_at(rates: Rates, k: int) -> tuple[int, Vec3]:
    """A rate, behind its time (us)."""
    return int(rates[k, 0]), (float(rates[k, 1]), float(rates[k, 2]), float(rates[k, 3]))


@inlined
def take_between(handle: Any, time_us: int, gyr_rad_s: Vec3) -> tuple[Between, Vec3]:
    """Up to the next sample by others' rates, too.

    Returns what those show of the turning up to there, and what the gyroscope reads, or what
    stands in for it.
    """
    state, rates, from_us = handle.turning, handle.rates, handle.time_us
    passed = 0
    while passed < len(rates) and rates[passed, 0] <= time_us:
        passed += 1
    state = compared(state, rates, passed, from_us, time_us, gyr_rad_s)
    shown = NOTHING_BETWEEN
    if agrees(state, NO_AXES):
        shown = integrate(state, rates, passed, from_us, time_us, gyr_rad_s)
    used = state.used + (1 if shown.given else 0)
    state = state._replace(last_gyr_rad_s=gyr_rad_s, used=used)
    if passed > 0:
        before_us, before = rate_at(rates, passed - 1)
        state = state._replace(before_us=before_us, before_rad_s=before)
    handle.rates = rates[passed:].copy()
    handle.turning, gyr = stand_in(state, time_us, gyr_rad_s, contradicted_axes(handle))
    return shown, gyr


@inlined
def integrate(
    state: Turning, rates: Rates, passed: int, from_us: int, time_us: int, gyr_rad_s: Vec3
) -> Between:
    """The turn through all readings in between, if there are any and no two too far apart."""
    # a rate so near the ends of the step is a sample's own
    edge_us = max(1e6 * ONE_MOMENT_S, SAME_INSTANT * (time_us - from_us))
    edge = int(np.rint(min(1e6 * SAME_INSTANT_S, edge_us)))
    turn, longest_s, squares, steps = IDENTITY, 0.0, ZERO_VEC3, 0
    t0, w0 = from_us, state.last_gyr_rad_s
    for k in range(passed + 1):
        t1, w1 = time_us, gyr_rad_s
        if k < passed:
            t1, w1 = rate_at(rates, k)
            w1 = add(w1, state.offset_rad_s)
            if not from_us + edge < t1 < time_us - edge:
                continue
        step_s = 1e-6 * (t1 - t0)
        turn = multiply(turn, exp(scale(step_s, integration_rate(w0, w1, step_s, False))))
        longest_s = max(longest_s, step_s)
        x, y, z = subtract(w1, w0)
        squares = add(squares, (x * x, y * y, z * z))
        steps += 1
        t0, w0 = t1, w1
    if steps < 2 or longest_s > UNSEEN_STEP_S:
        return NOTHING_BETWEEN
    x, y, z = squares
    change = (sqrt(x / steps), sqrt(y / steps), sqrt(z / steps))
    return Between(True, scale(1e6 / (time_us - from_us), log(turn)), change, longest_s)


@inlined
def compared(
    state: Turning, rates: Rates, passed: int, from_us: int, time_us: int, gyr_rad_s: Vec3
) -> Turning:
    """The sample beside the rate interpolated at its time, where two are near enough.

    A rate of the sample before, which has come behind it, is compared with that one.
    """
    near_us, there = state.before_us, state.before_rad_s
    if passed > 0:
        near_us, there = rate_at(rates, passed - 1)
    if near_us == NEVER_US:
        return state
    apart_s = 1e-6 * (time_us - near_us)
    if passed > 0 and near_us == from_us:
        if state.before_us == NEVER_US:
            return state
        apart_s, gyr_rad_s = 0.0, state.last_gyr_rad_s
    if apart_s > SAME_INSTANT_S:
        if len(rates) == passed:
            return state
        ahead_us, ahead = rate_at(rates, passed)
        if 1e-6 * (ahead_us - near_us) > UNSEEN_STEP_S:
            return state
        share = (time_us - near_us) / (ahead_us - near_us)
        there = add(scale(1.0 - share, there), scale(share, ahead))
    x, y, z = subtract(subtract(gyr_rad_s, there), state.offset_rad_s)
    step_s = max(1e-3, apart_s + 0.25)
    a = step_s / (AGREEMENT_TAU_S + step_s)
    b = step_s / (min(OFFSET_TAU_S, state.compared_s) + step_s)
    no_x, no_y, no_z = state.stands_in
    known = (0.0 if no_x else b * x, 0.0 if no_y else b * y, 0.0 if no_z else b * z)
    offset = add(state.offset_rad_s, known)
    if norm(offset) > MOST_OFFSET_RAD_S:
        offset = scale(MOST_OFFSET_RAD_S / norm(offset), offset)
    misfit = approach(state.misfit, (x * x, y * y, z * z), a)
    x, y, z = gyr_rad_s
    turning = approach(state.turning, (x * x, y * y, z * z), a)
    return state._replace(
        offset_rad_s=offset, misfit=misfit, turning=turning, compared_s=state.compared_s + step_s
    )


@inlined
def stand_in(
    state: Turning, time_us: int, gyr_rad_s: Vec3, contradicted: Axes
) -> tuple[Turning, Vec3]:
    """The gyroscope's reading with the latest rates in place of ``contradicted`` axes.

    An axis stays replaced until the two agree about it again.
    """
    is_old = state.before_us == NEVER_US or 1e-6 * (time_us - state.before_us) > UNSEEN_STEP_S
    x = is_replaced(state, contradicted, 0)
    y = is_replaced(state, contradicted, 1)
    z = is_replaced(state, contradicted, 2)
    axes = (x, y, z)
    is_any, is_all = x or y or z, x and y and z
    if is_old or not is_any or is_all or not agrees(state, axes):
        return state._replace(stands_in=NO_AXES), gyr_rad_s
    there = add(state.before_rad_s, state.offset_rad_s)
    gyr = (
        there[0] if x else gyr_rad_s[0],
        there[1] if y else gyr_rad_s[1],
        there[2] if z else gyr_rad_s[2],
    )
    return state._replace(stands_in=axes), gyr


@inlined
def is_replaced(state: Turning, contradicted: Axes, axis: int) -> bool:
    """Whether the rates are to stand in for an axis, or go on to do so.

    Where both turn out to show the same turning, the field is wrong.
    """
    least = MOST_MISFIT * LEAST_TURNING_RAD_S * LEAST_TURNING_RAD_S
    misfit = state.misfit[axis]
    compared_s = min(AGREEMENT_TAU_S, state.compared_s)
    differs = misfit * AGREEMENT_TAU_S > least * compared_s or compared_s < LEAST_COMPARED_S
    return bool((contradicted[axis] and differs) or (state.stands_in[axis] and misfit > least))
