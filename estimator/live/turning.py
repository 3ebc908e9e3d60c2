"""Body rates by another messenger: what shows the turning between two IMU samples.

An autopilot's ATTITUDE carries the rates of its own gyroscope, less the bias it has learnt.
Where it comes at other instants than the IMU's samples, the turn over a step is integrated
through all of them. Where it comes with the samples, nothing is between and nothing changes, but
for an axis that the samples' gyroscope has wrong by the word of field and force: there the rates
stand in for it, if they agree with the samples about the other axes.
"""

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

from estimator.conditioning.vertical.rate import integration_rate
from estimator.geometry.quaternion import (
    add,
    exp,
    log,
    multiply,
    norm,
    scale,
    subtract,
)
from estimator.types import (
    IDENTITY,
    NOTHING_BETWEEN,
    UNSEEN_STEP_S,
    ZERO_VEC3,
    Between,
    RateSample,
    Vec3,
)

# More rates than this are not kept: 5 s of 50 a second; a longer hole stays one.
MOST_WAITING = 256
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


Axes = tuple[bool, bool, bool]
NO_AXES: Axes = (False, False, False)


class Turning(NamedTuple):
    """The rates since the last IMU sample, and how well they have agreed with the samples."""

    waiting: tuple[RateSample, ...] = ()
    before: RateSample | None = None  # the last one that a sample has passed
    last_gyr_rad_s: Vec3 = ZERO_VEC3
    offset_rad_s: Vec3 = ZERO_VEC3  # samples less rates
    misfit: Vec3 = ZERO_VEC3  # mean squares of the difference, (rad/s)^2
    turning: Vec3 = ZERO_VEC3  # mean squares of the samples' rate, (rad/s)^2
    compared_s: float = 0.0  # for how long both have been compared
    used: int = 0  # steps that were integrated through rates
    stands_in: Axes = NO_AXES  # where the rates stand in for the samples

    def agrees(self, but: Axes = NO_AXES) -> bool:
        """Whether the rates show what the samples show, as far as there was anything to show.

        All axes count ``but`` those.
        """
        if but is NO_AXES:
            x, y, z = self.misfit
            u, v, w = self.turning
            misfit, turning = x + y + z, u + v + w
        else:
            misfit = sum(m for m, is_out in zip(self.misfit, but, strict=True) if not is_out)
            turning = sum(t for t, is_out in zip(self.turning, but, strict=True) if not is_out)
        return misfit <= MOST_MISFIT * max(turning, LEAST_TURNING_RAD_S**2)


STILL = Turning()  # nobody has told any


def hear_rate(state: Turning, rate: RateSample) -> Turning:
    """One more rate; those that are not later than the one before are dropped."""
    last = state.waiting[-1] if state.waiting else state.before
    if last is not None and rate.time_us <= last.time_us:
        return state
    return Turning((*state.waiting, rate)[-MOST_WAITING:], *state[1:])


def take_between(
    state: Turning, from_us: int, time_us: int, gyr_rad_s: Vec3
) -> tuple[Turning, Between]:
    """What the rates show between the samples of ``from_us`` and ``time_us``, the latter's gyro."""
    passed = tuple(r for r in state.waiting if r.time_us <= time_us)
    ahead = state.waiting[len(passed) :]
    if not passed and not ahead and state.before is None:
        return state, NOTHING_BETWEEN
    state = _compare(state, passed, ahead, from_us, time_us, gyr_rad_s)
    shown = NOTHING_BETWEEN
    if state.agrees():
        edge_us = _edge_us(time_us - from_us)
        inside = [r for r in passed if from_us + edge_us < r.time_us < time_us - edge_us]
        shown = _integrate(state, inside, from_us, time_us, gyr_rad_s)
    state = Turning(
        ahead,
        passed[-1] if passed else state.before,
        gyr_rad_s,
        state.offset_rad_s,
        state.misfit,
        state.turning,
        state.compared_s,
        state.used + shown.given,
        state.stands_in,
    )
    return state, shown


def _edge_us(step_us: int) -> int:
    """How near the ends of a step a rate is a sample's own."""
    of_step_us = max(1e6 * ONE_MOMENT_S, SAME_INSTANT * step_us)
    return round(min(1e6 * SAME_INSTANT_S, of_step_us))


def _integrate(
    state: Turning, inside: list[RateSample], from_us: int, time_us: int, gyr_rad_s: Vec3
) -> Between:
    """The turn through all readings, if no two of them are too far apart."""
    if not inside:
        return NOTHING_BETWEEN
    points = [(from_us, state.last_gyr_rad_s)]
    points += [(r.time_us, add(r.rate_rad_s, state.offset_rad_s)) for r in inside]
    points.append((time_us, gyr_rad_s))
    turn, longest, squares = IDENTITY, 0.0, ZERO_VEC3
    for (t0, w0), (t1, w1) in pairwise(points):
        step_s = 1e-6 * (t1 - t0)
        turn = multiply(turn, exp(scale(step_s, integration_rate(w0, w1, step_s, averaged=False))))
        longest = max(longest, step_s)
        change = subtract(w1, w0)
        squares = add(squares, (change[0] ** 2, change[1] ** 2, change[2] ** 2))
    if longest > UNSEEN_STEP_S:
        return NOTHING_BETWEEN
    n = len(points) - 1
    x, y, z = (sqrt(s / n) for s in squares)
    return Between(True, scale(1e6 / (time_us - from_us), log(turn)), (x, y, z), longest)


def _compare(
    state: Turning,
    passed: tuple[RateSample, ...],
    ahead: tuple[RateSample, ...],
    from_us: int,
    time_us: int,
    gyr_rad_s: Vec3,
) -> Turning:
    """The sample beside the rate interpolated at its time, where two are near enough.

    A rate of the sample before, which has come behind it, is compared with that one.
    """
    near = passed[-1] if passed else state.before
    if near is None:
        return state
    there = near.rate_rad_s
    apart_s = 1e-6 * (time_us - near.time_us)
    if passed and near.time_us == from_us:
        if state.before is None:
            return state
        apart_s, gyr_rad_s = 0.0, state.last_gyr_rad_s
    if apart_s > SAME_INSTANT_S:
        if not ahead or 1e-6 * (ahead[0].time_us - near.time_us) > UNSEEN_STEP_S:
            return state
        share = (time_us - near.time_us) / (ahead[0].time_us - near.time_us)
        there = add(scale(1.0 - share, near.rate_rad_s), scale(share, ahead[0].rate_rad_s))
    off = subtract(gyr_rad_s, there)
    left = subtract(off, state.offset_rad_s)
    step_s = max(1e-3, apart_s + 0.25)
    a = step_s / (AGREEMENT_TAU_S + step_s)
    b = step_s / (min(OFFSET_TAU_S, state.compared_s) + step_s)
    x, y, z = left
    no_x, no_y, no_z = state.stands_in
    known = (0.0 if no_x else b * x, 0.0 if no_y else b * y, 0.0 if no_z else b * z)
    offset = add(state.offset_rad_s, known)
    if norm(offset) > MOST_OFFSET_RAD_S:
        offset = scale(MOST_OFFSET_RAD_S / norm(offset), offset)
    return Turning(
        state.waiting,
        state.before,
        state.last_gyr_rad_s,
        offset,
        _averaged(state.misfit, left, a),
        _averaged(state.turning, gyr_rad_s, a),
        state.compared_s + step_s,
        state.used,
        state.stands_in,
    )


def _averaged(mean: Vec3, v: Vec3, share: float) -> Vec3:
    """Mean squares of a vector's parts, with one more."""
    x, y, z = mean
    a, b, c = v
    return (x + share * (a * a - x), y + share * (b * b - y), z + share * (c * c - z))


def stand_in(
    state: Turning, time_us: int, gyr_rad_s: Vec3, contradicted: Axes
) -> tuple[Turning, Vec3]:
    """The gyroscope's reading with the latest rates in place of ``contradicted`` axes.

    An axis stays replaced until the two agree about it again.
    """
    if not any(contradicted) and not any(state.stands_in):
        return state, gyr_rad_s  # as nearly always
    latest = state.before
    if latest is None or 1e-6 * (time_us - latest.time_us) > UNSEEN_STEP_S:
        return state._replace(stands_in=NO_AXES), gyr_rad_s
    doubted = [
        is_new or (is_old and misfit > MOST_MISFIT * LEAST_TURNING_RAD_S**2)
        for is_new, is_old, misfit in zip(contradicted, state.stands_in, state.misfit, strict=True)
    ]
    axes = (doubted[0], doubted[1], doubted[2])
    if not any(axes) or all(axes) or not state.agrees(but=axes):
        return state._replace(stands_in=NO_AXES), gyr_rad_s
    there = add(latest.rate_rad_s, state.offset_rad_s)
    x, y, z = (r if is_out else w for r, w, is_out in zip(there, gyr_rad_s, axes, strict=True))
    return state._replace(stands_in=axes), (x, y, z)
