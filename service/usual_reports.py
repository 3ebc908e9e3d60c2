"""Places and velocities of vehicles that just go on, for compiled code.

As :mod:`service.report_choice` and :mod:`estimator.live.reports` have them.
"""

from typing import Any

from drivers.mavlink.usual_kinds import MOVES, RECEIVER
from drivers.samples.fix import RECEIVER_LATE_SIGMA_S
from estimator.aiding.place import NEAR_DEG
from estimator.aiding.sources.velocity import SPEED_LIMIT_M_S
from estimator.aiding.trail import OLDEST_S
from estimator.aiding.types import NO_REPORT, Report
from estimator.compilation.compiled import inlined
from estimator.live.reports import MOST_WAITING
from estimator.live.resident import AIDED, RAW, hear
from estimator.types import Vec3, VelocitySample
from service.report_choice import SILENCE_US
from service.second_opinion import STRIDE_S
from service.usual_columns import (
    HERE,
    LEFT,
    MINDS_PLACES,
    RECEIVER_US,
    SOURCE,
    STRIDE_US,
    TAKEN,
    TELL,
    VELOCITY,
    VELOCITY_US,
    WAITING,
    Floats,
    Whole,
)


@inlined
def is_here(row: Whole, reals: Floats, place: Vec3) -> bool:
    """Whether a position says nothing new."""
    away_deg = abs(place[0] - reals[HERE]) + abs(place[1] - reals[HERE + 1])
    return bool(row[MINDS_PLACES] == 0 or away_deg < NEAR_DEG)


@inlined
def take_velocity(
    inside: Any,
    row: Whole,
    waiting: Floats,
    fix: tuple[int, int, int, int],
    velocity: Vec3,
    sigma_m_s: float,
) -> int:
    """A message's velocity, the receiver's or the filter's; see :mod:`service.report_choice`."""
    kind, arrival_us, time_us, flags = fix
    is_filters = kind != RECEIVER
    if flags & MOVES == 0:
        return TAKEN
    if not is_filters and row[RECEIVER_US] < 0:
        return LEFT
    if is_filters and kind != row[VELOCITY]:
        is_worse = 0 < row[VELOCITY] < kind
        is_silent = arrival_us - row[VELOCITY_US] > SILENCE_US
        return TAKEN if is_worse and not is_silent else LEFT
    if max(abs(velocity[0]), abs(velocity[1]), abs(velocity[2])) > SPEED_LIMIT_M_S:
        return LEFT
    row[VELOCITY_US if is_filters else RECEIVER_US] = arrival_us
    late_sigma_s = 0.0 if is_filters else RECEIVER_LATE_SIGMA_S
    if row[SOURCE] == AIDED and time_us <= inside.time_us:
        ago_s = 1e-6 * (inside.time_us - time_us)
        if ago_s <= OLDEST_S:
            hear(inside, Report(True, velocity, is_filters, sigma_m_s, ago_s, late_sigma_s))
    elif row[SOURCE] != RAW:
        n = row[WAITING]
        if n == MOST_WAITING:
            waiting[: n - 1] = waiting[1:n].copy()
            n -= 1
        row[WAITING] = n + 1
        write_report(waiting[n], time_us, velocity, (sigma_m_s, late_sigma_s))
    since_us = time_us - row[STRIDE_US]
    return TAKEN if since_us > 0 and 1e-6 * since_us < STRIDE_S else TELL


@inlined
def write_report(at: Floats, time_us: int, velocity: Vec3, sigmas: tuple[float, float]) -> None:
    """Keep a velocity; a receiver's, whose age is uncertain, has no vertical part."""
    at[0], at[4], at[5], at[6] = time_us, 1.0 if sigmas[1] == 0.0 else 0.0, sigmas[0], sigmas[1]
    at[1], at[2], at[3] = velocity


@inlined
def report_of(at: Floats, time_us: int) -> Report:
    """A velocity that waited, as it is seen from the sample of ``time_us``."""
    velocity = (float(at[1]), float(at[2]), float(at[3]))
    return Report(True, velocity, at[4] != 0.0, float(at[5]), 1e-6 * (time_us - int(at[0])), at[6])


@inlined
def reaches(row: Whole, waiting: Floats, time_us: int) -> bool:
    """Whether the sample of ``time_us`` reaches a velocity that waits."""
    k = 0
    while k < row[WAITING] and waiting[k, 0] > time_us:
        k += 1
    return bool(k < row[WAITING])


@inlined
def take_due(
    row: Whole, waiting: Floats, time_us: int, oldest_s: float
) -> tuple[int, Report, Report]:
    """How many are due, and those, as :func:`estimator.live.reports.take_due` has it.

    The latest of each source; the source whose first one was the earlier one comes first.
    """
    n, ahead = row[WAITING], 0
    first = [-1, -1]
    last = [-1, -1]
    for k in range(n):
        if waiting[k, 0] > time_us:
            continue
        source = 1 if waiting[k, 6] > 0.0 else 0
        if first[source] < 0 or waiting[k, 0] < waiting[first[source], 0]:
            first[source] = k
        if last[source] < 0 or waiting[k, 0] >= waiting[last[source], 0]:
            last[source] = k
    one, other = last[0], last[1]
    if one >= 0 and other >= 0:
        a, b = waiting[first[0], 0], waiting[first[1], 0]
        if b < a or (a == b and first[1] < first[0]):
            one, other = other, one
    elif one < 0:
        one, other = other, one
    reports = (NO_REPORT, NO_REPORT)
    if one >= 0:
        reports = (report_of(waiting[one], time_us), NO_REPORT)
    if other >= 0:
        reports = (reports[0], report_of(waiting[other], time_us))
    for k in range(n):
        if waiting[k, 0] > time_us:
            waiting[ahead] = waiting[k]
            ahead += 1
    row[WAITING] = ahead
    if other >= 0 and reports[1].ago_s > oldest_s:
        reports, other = (reports[0], NO_REPORT), -1
    if one >= 0 and reports[0].ago_s > oldest_s:
        reports, one, other = (reports[1], NO_REPORT), other, -1
    return (one >= 0) + (other >= 0), reports[0], reports[1]


def write_sample(at: Floats, sample: VelocitySample) -> None:
    """Keep a velocity of either source."""
    time_us, velocity, *others = sample
    at[:] = time_us, *velocity, *others


def sample_of(numbers: list[float]) -> VelocitySample:
    """A velocity that waits."""
    time_us, x, y, z, has_vertical, sigma_m_s, late_sigma_s = numbers
    return VelocitySample(int(time_us), (x, y, z), has_vertical != 0.0, sigma_m_s, late_sigma_s)
