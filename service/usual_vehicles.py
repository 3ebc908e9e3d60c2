"""Vehicles whose samples just go on with those before, all taken in one call of compiled code.

:class:`~service.vehicle.Vehicle` holds the rules for everything that may happen to one, in Python.
What they come to for a vehicle that runs, and sends sound samples of the IMU message in use, with
velocity and others' rates or without, is here, for many at a time and to the same bits. A row that
is anything
else is left to Python, with all that follow of its vehicle; what is known of that is handed back
before, and taken over again behind it.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from math import degrees, inf, isfinite, pi
from typing import Any, NamedTuple, Self

import numba
import numpy as np
from numba.core import types

from drivers.events import VehicleId
from drivers.mavlink.usual_frames import (
    ATTITUDE,
    FRESH,
    GIVES,
    IS_THERE,
    LOCAL_POSITION,
    MOVES,
    NO_DATA,
    SILENT,
    TO_LOOK,
    Readings,
)
from estimator.aiding.place import NEAR_DEG
from estimator.aiding.sources.velocity import SPEED_LIMIT_M_S
from estimator.aiding.trail import OLDEST_S
from estimator.aiding.types import NO_REPORT, Report
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import direct
from estimator.estimator import Estimator
from estimator.geometry.frames import euler_rad
from estimator.live.interval import is_gap
from estimator.live.refusal import FINE, RATE_LIMIT_RAD_S, fault_of
from estimator.live.reports import MOST_WAITING
from estimator.live.resident import (
    AIDED,
    CONDITIONED,
    RAW,
    advance,
    advance_aided,
    advance_raw,
    hear,
    hear_rate,
    publish,
    turn_on,
)
from estimator.types import ZERO_VEC3, Vec3, VelocitySample
from service.attitude_rows import HAS_MAG as SHOWN_HAS_MAG
from service.attitude_rows import READINGS, ROW_WHOLE, SAMPLE_US, AttitudeRows
from service.attitude_text import (
    AGE_US,
    BOOT_US,
    NUMBER_OF_WORD,
    NUMBERS,
    REFERENCE,
    SEQUENCE,
    STATE,
    UNIX_US,
)
from service.health import LATE_MINIMUM_US, State, late_after_us
from service.host_clock import HostClock, Offsets, observe
from service.imu_choice import STAND_IN_GAP_US, longest_silence_us
from service.intervals import CHECKED_EVERY, MEDIAN_EVERY, OTHER_CLOCK_US, PERIODS_KEPT
from service.report_choice import SILENCE_US
from service.second_opinion import STRIDE_S
from service.showing import is_due, shown_at
from service.vehicle import Vehicle

# numba ships no types; arrays of int64 and float64
_typeof: Any = numba.typeof
_types: Any = types
Whole = Any
Floats = Any

# Columns of a vehicle's whole numbers: when it was heard, the IMU message in use, and the one that
# is proving itself,
HEARD, CHOSEN, CHOSEN_US, LONGEST_SILENCE = 0, 1, 2, 3
RIVAL, RIVAL_SAMPLES, RIVAL_SINCE, RIVAL_US = 4, 5, 6, 7
# when rates came last (negative if never), whether they are used,
RATES_US, USES_RATES = 8, 9
# the message whose velocity is used, when that came last, when a stride of velocity began,
VELOCITY, VELOCITY_US, STRIDE_US = 10, 11, 12
# the last sample's times, the counts, when to look for alarms, what was published last,
ARRIVAL, TIME, BOOT, HAS_MAG = 13, 14, 15, 16
SAMPLES, WORST_GAP, LOOK_US = 17, 18, 19
ATTITUDES, SHOWN_SAMPLES, SHOWN_US = 20, 21, 22
# the clock's, the median interval and the intervals it is made of, the oldest of them at AT.
CLOCK_AT, WINDOW, EVEN = 23, 24, 26
MEDIAN, PERIODS, AT, RING = 28, 29, 30, 31
# Behind the intervals what the estimator says of itself, see :class:`estimator.estimator.Lent`.
SOURCE = RING + PERIODS_KEPT
MINDS_GAPS, KNOWS_NORTH, HAS_RATES, WAITING, MINDS_PLACES = (SOURCE + k for k in range(1, 6))
STATE_SIZE = MINDS_PLACES + 1
# And of its other numbers: of the clock, of the sample, the heading's least sigma, the place.
OFFSET, SPANS, READING, LEAST_HEADING, HERE = 0, 1, 5, 14, 15
STATE_NUMBERS = 17
# A velocity that waits for a sample: time, velocity, whether that has a vertical part, both sigmas.
REPORT_SIZE = 7

# What has become of a row: taken; left; taken, but the estimate is to be checked, or judged, since
# measurements contradict it, or compared with the attitude beside these rates, or a velocity is to
# be told to whoever compares.
TAKEN, LEFT, CHECK, DOUBT, COMPARE, TELL = 0, 1, 2, 3, 4, 5
# And of a vehicle at a tick: nothing is wanted of it, it is shown, or there is more to do.
UNWANTED, SHOWN, MORE = 0, 1, 2
# At first there are places for so many.
LEAST_PLACES = 16
# Which are wanted at a tick.
NONE, DUE, ALL = 0, 1, 2
RUNNING = NUMBER_OF_WORD[State.RUNNING.value]


@compiled
def take_rows(
    fleet: Any,
    index: Whole,
    state: tuple[Whole, Floats, Whole, Floats],
    batch: int,
    addresses: Whole,
    rows: tuple[Whole, Floats, Whole],
    left: Whole,
) -> int:
    """Take the rows of :class:`Readings`; returns how many are not just taken.

    ``index`` by address is 1 more than a vehicle's place in ``fleet`` and ``state``, whose third
    array has the number of the ``batch`` that a vehicle was last left in, and the fourth the
    velocities that wait.
    """
    state_whole, state_numbers, left_in, waiting = state
    whole, numbers, arrivals_us = rows
    unusual = 0
    for k in range(len(arrivals_us)):
        left[k] = 0
        kind = whole[k, 0]
        if kind == SILENT:
            continue
        v = index[addresses[whole[k, 1]]] - 1
        if v < 0 or left_in[v] == batch:
            left[k] = LEFT
            unusual += 1
            continue
        row, time_us, arrival_us, flags = state_whole[v], whole[k, 2], arrivals_us[k], whole[k, 4]
        first, second, third = three(numbers, k, 0), three(numbers, k, 3), three(numbers, k, 6)
        if kind == ATTITUDE:
            done = take_rates(fleet[v], row, arrival_us, time_us, first, flags)
        elif kind >= LOCAL_POSITION:
            done = LEFT
            if flags & IS_THERE == 0 or is_here(row, state_numbers[v], second):
                fix = (kind, arrival_us, time_us, flags)
                done = take_velocity(fleet[v], row, waiting[v], fix, first, third[0])
        elif flags >= NO_DATA:  # or its field is none
            done = LEFT
            if flags & NO_DATA != 0 and kind != row[CHOSEN]:
                done, row[HEARD] = TAKEN, arrival_us
        elif kind != row[CHOSEN]:
            done = note_rival(row, kind, arrival_us)
        else:
            has_mag = flags & FRESH != 0
            reading = (first, second, third if has_mag else ZERO_VEC3)
            times_us = (time_us, arrival_us, whole[k, 3])
            numbers_of = (state_numbers[v], waiting[v])
            done = take_sample(fleet[v], row, numbers_of, times_us, reading, has_mag)
        if done != TAKEN:
            left[k], left_in[v] = done, batch
            unusual += 1
    return unusual


@inlined
def three(numbers: Floats, k: int, at: int) -> Vec3:
    """A vector of a row."""
    return (numbers[k, at], numbers[k, at + 1], numbers[k, at + 2])


@inlined
def take_rates(
    inside: Any, row: Whole, arrival_us: int, time_us: int, rate: Vec3, flags: int
) -> int:
    """Rates that change nothing, since they come with the samples."""
    done = COMPARE if flags & GIVES != 0 else TAKEN
    if abs(arrival_us - time_us - (row[ARRIVAL] - row[TIME])) > OTHER_CLOCK_US:
        return done
    is_fine = max(abs(rate[0]), abs(rate[1]), abs(rate[2])) <= RATE_LIMIT_RAD_S
    if row[RATES_US] < 0 or not is_fine:
        return LEFT
    if row[USES_RATES] == 1 and hear_rate(inside, time_us, rate[0], rate[1], rate[2]):
        row[HAS_RATES] = 1
    row[RATES_US] = arrival_us
    return done


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
    """The velocity of the autopilot's filter by a message; see :mod:`service.report_choice`."""
    kind, arrival_us, time_us, flags = fix
    if flags & MOVES == 0:
        return TAKEN
    if kind != row[VELOCITY]:
        is_worse = 0 < row[VELOCITY] < kind
        is_silent = arrival_us - row[VELOCITY_US] > SILENCE_US
        return TAKEN if is_worse and not is_silent else LEFT
    if max(abs(velocity[0]), abs(velocity[1]), abs(velocity[2])) > SPEED_LIMIT_M_S:
        return LEFT
    row[VELOCITY_US] = arrival_us
    if row[SOURCE] == AIDED and time_us <= inside.time_us:
        ago_s = 1e-6 * (inside.time_us - time_us)
        if ago_s <= OLDEST_S:
            hear(inside, Report(True, velocity, True, sigma_m_s, ago_s, 0.0))
    elif row[SOURCE] != RAW:
        n = row[WAITING]
        if n == MOST_WAITING:
            waiting[: n - 1] = waiting[1:n].copy()
            n -= 1
        row[WAITING] = n + 1
        write_report(waiting[n], time_us, velocity, sigma_m_s)
    since_us = time_us - row[STRIDE_US]
    return TAKEN if since_us > 0 and 1e-6 * since_us < STRIDE_S else TELL


@inlined
def write_report(at: Floats, time_us: int, velocity: Vec3, sigma_m_s: float) -> None:
    """Keep a velocity with all three parts."""
    at[0], at[4], at[5], at[6] = time_us, 1.0, sigma_m_s, 0.0
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


@inlined
def note_rival(row: Whole, kind: int, arrival_us: int) -> int:
    """A sample of a worse message, while the one in use comes: see :mod:`service.imu_choice`."""
    if kind < row[CHOSEN] or not 0 <= arrival_us - row[CHOSEN_US] < LATE_MINIMUM_US:
        return LEFT
    row[HEARD] = arrival_us
    longest_us = max(late_after_us(float(row[MEDIAN])), STAND_IN_GAP_US)
    goes_on = arrival_us - row[RIVAL_US] <= longest_us
    if row[RIVAL] == kind and goes_on:
        row[RIVAL_SAMPLES] += 1
        row[RIVAL_US] = arrival_us
    elif not (row[RIVAL] not in (0, kind) and goes_on and kind >= row[RIVAL]):
        row[RIVAL], row[RIVAL_SAMPLES] = kind, 1
        row[RIVAL_SINCE] = row[RIVAL_US] = arrival_us
    return TAKEN


@inlined
def take_sample(
    inside: Any,
    row: Whole,
    numbers: tuple[Floats, Floats],
    times_us: tuple[int, int, int],
    reading: tuple[Vec3, Vec3, Vec3],
    has_mag: bool,
) -> int:
    """A sample of the message in use; its times are the vehicle's, of arrival, and of boot."""
    time_us, arrival_us, boot_us = times_us
    gyr, acc, mag = reading
    reals, waiting = numbers
    is_checked = (row[SAMPLES] + 1) % CHECKED_EVERY == 0
    source = row[SOURCE]
    is_first_heading = has_mag and not inside.seen.has_heading
    if source == CONDITIONED and (is_first_heading or reaches(row, waiting, time_us)):
        return LEFT
    if fault_of(gyr, acc, mag) != FINE or time_us <= inside.time_us:
        return LEFT
    dt_s = 1e-6 * (time_us - inside.time_us)
    if row[MINDS_GAPS] == 1 and is_gap(inside.usual_s, dt_s):
        return LEFT
    row[HEARD] = arrival_us
    row[LONGEST_SILENCE] = longest_silence_us(row[LONGEST_SILENCE], arrival_us - row[CHOSEN_US])
    row[CHOSEN_US], row[RIVAL] = arrival_us, 0
    gx, gy, gz = gyr
    ax, ay, az = acc
    mx, my, mz = mag
    goes_on = True
    if source == RAW:
        advance_raw(inside, time_us, gx, gy, gz, ax, ay, az, mx, my, mz, has_mag)
    else:
        if row[HAS_RATES] == 1 and row[USES_RATES] == 1:
            _, gx, gy, gz = turn_on(inside, time_us, gx, gy, gz)
        is_aided = source == AIDED
        advance(inside, time_us, gx, gy, gz, ax, ay, az, mx, my, mz, has_mag, is_aided, 0)
        if is_aided:
            oldest_s = max(OLDEST_S, dt_s)
            count, report, other = take_due(row, waiting, time_us, oldest_s)
            goes_on = advance_aided(inside, report, row[KNOWS_NORTH] == 1)
            if goes_on and count == 2:
                hear(inside, other)
    note_interval(row, time_us - row[TIME])
    write_clock(row, reals, observe(clock_of(row, reals), time_us, arrival_us))
    row[ARRIVAL], row[TIME], row[BOOT] = arrival_us, time_us, boot_us
    row[HAS_MAG] = has_mag
    for i in range(3):
        reals[READING + i], reals[READING + 3 + i], reals[READING + 6 + i] = gyr[i], acc[i], mag[i]
    row[SAMPLES] += 1
    if not goes_on:
        return DOUBT
    if not is_checked:
        return TAKEN
    if time_us >= row[LOOK_US]:
        return CHECK
    said = publish(inside, time_us, source)
    return TAKEN if is_finite(said[1], said[2]) else CHECK


@inlined
def note_interval(row: Whole, period_us: int) -> None:
    """One more interval between samples, and the median where it is due."""
    row[WORST_GAP] = max(row[WORST_GAP], period_us)
    row[RING + row[AT]] = period_us
    row[AT] = (row[AT] + 1) % PERIODS_KEPT
    row[PERIODS] = min(row[PERIODS] + 1, PERIODS_KEPT)
    n = row[PERIODS]
    if n < PERIODS_KEPT or row[SAMPLES] % MEDIAN_EVERY == 0:
        row[MEDIAN] = np.sort(row[RING : RING + n])[n // 2]


@inlined
def clock_of(row: Whole, reals: Floats) -> HostClock:
    """The clock in a row."""
    return HostClock(
        reals[OFFSET],
        row[CLOCK_AT],
        True,
        Offsets(row[WINDOW], reals[SPANS], reals[SPANS + 1], row[WINDOW + 1]),
        Offsets(row[EVEN], reals[SPANS + 2], reals[SPANS + 3], row[EVEN + 1]),
    )


@inlined
def write_clock(row: Whole, reals: Floats, clock: HostClock) -> None:
    """Put a clock into a row."""
    reals[OFFSET], row[CLOCK_AT] = clock.offset_us, clock.at_us
    window, even = clock.window, clock.even
    row[WINDOW], row[WINDOW + 1] = window.begin_us, window.samples
    row[EVEN], row[EVEN + 1] = even.begin_us, even.samples
    reals[SPANS], reals[SPANS + 1] = window.least_us, window.most_us
    reals[SPANS + 2], reals[SPANS + 3] = even.least_us, even.most_us


@inlined
def is_finite(moved: Any, figures: Any) -> bool:
    """Whether all that is published is finite; an infinite sigma just means "unknown"."""
    q, rate, bias, error, error_rate, gain = moved
    vectors = rate[0] + rate[1] + rate[2] + bias[0] + bias[1] + bias[2]
    scalars = error + error_rate + gain + figures[0] + figures[1]
    return isfinite(q[0] + q[1] + q[2] + q[3] + vectors + scalars)


@compiled
def show_rows(
    fleet: Any,
    places: Whole,
    state: tuple[Whole, Floats, Whole, Floats],
    references: Whole,
    now_us: int,
    wanted: int,
    done: Whole,
    shown: tuple[Whole, Floats, Floats],
) -> int:
    """Write what is published of the vehicles at ``places``; returns how many those are.

    ``done`` says what has become of each. ``references`` has, by place, what a heading is measured
    from, with one and without. Those that are shown count it.
    """
    state_whole, state_numbers = state[:2]
    out_whole, out, readings = shown
    n = 0
    for k in range(len(places)):
        row, reals = state_whole[places[k]], state_numbers[places[k]]
        done[k] = MORE
        if now_us - row[ARRIVAL] >= LATE_MINIMUM_US:
            continue
        done[k] = UNWANTED
        is_new = is_due(row[SAMPLES] != row[SHOWN_SAMPLES], now_us - row[SHOWN_US])
        if wanted == NONE or (wanted == DUE and not is_new):
            continue
        done[k] = MORE
        clock, last_us = clock_of(row, reals), (row[TIME], row[ARRIVAL])
        time_us, age_us = shown_at(clock, last_us, float(row[MEDIAN]), now_us)
        _, moved, figures, has_heading = publish(fleet[places[k]], time_us, row[SOURCE])
        if not is_finite(moved, figures):
            continue
        done[k], whole = SHOWN, out_whole[n]
        whole[UNIX_US], whole[BOOT_US] = now_us, row[BOOT] + time_us - row[TIME]
        whole[AGE_US], whole[SEQUENCE], whole[STATE] = max(0, age_us), row[ATTITUDES], RUNNING
        whole[REFERENCE] = references[places[k], 0 if has_heading else 1]
        write_shown(out[n], moved, figures, reals[LEAST_HEADING])
        whole[SAMPLE_US], whole[SHOWN_HAS_MAG] = row[TIME], row[HAS_MAG]
        for i in range(READINGS):
            readings[n, i] = reals[READING + i]
        row[ATTITUDES] += 1
        row[SHOWN_SAMPLES], row[SHOWN_US] = row[SAMPLES], now_us
        n += 1
    return n


@inlined
def write_shown(row: Floats, moved: Any, figures: Any, least_heading_rad: float) -> None:
    """The numbers of an attitude, in the order of its record's fields."""
    q, rate, bias, error, error_rate, gain = moved
    euler = euler_rad(q)
    for i in range(4):
        row[i] = q[i]
    for i in range(3):
        row[4 + i], row[7 + i], row[10 + i] = degrees(euler[i]), rate[i], bias[i]
    row[13], row[14], row[15] = error, error_rate, gain
    row[16], row[17] = figures[0], figures[1]
    inclination, heading = figures[2], max(figures[3], least_heading_rad)
    row[18] = degrees(inclination) if inclination < pi else 180.0
    row[19] = degrees(heading) if heading < pi else 180.0


@compiled
def new_fleet(inside: Any) -> Any:
    """A list for handles on compiled memory, with one of them."""
    fleet = numba.typed.List()
    fleet.append(inside)
    return fleet


@compiled
def put(fleet: Any, place: int, inside: Any) -> None:
    """Put a handle at a place, or at the end."""
    if place < len(fleet):
        fleet[place] = inside
    else:
        fleet.append(inside)


class Rest(NamedTuple):
    """Rows with more to do than to be taken; by what it is."""

    looks: Sequence[int] = ()  # magnitudes are to be looked at
    left: Sequence[int] = ()
    checks: Sequence[int] = ()  # an estimate is to be checked,
    doubts: Sequence[int] = ()  # or judged,
    compared: Sequence[int] = ()  # or compared with an attitude,
    told: Sequence[int] = ()  # or a velocity told to whoever does so


RESTS = (LEFT, CHECK, DOUBT, COMPARE, TELL)


class _Here(NamedTuple):
    """The vehicles that are here."""

    addresses: list[VehicleId]
    places: Whole
    known: frozenset[VehicleId]

    @classmethod
    def of(cls, vehicles: list[Vehicle | None]) -> Self:
        """Those of the places that are taken."""
        here = [(each.address, k) for k, each in enumerate(vehicles) if each is not None]
        addresses = [address for address, _ in here]
        return cls(addresses, np.array([k for _, k in here], np.int64), frozenset(addresses))


class UsualVehicles:
    """Keeps the numbers of the vehicles that it steps; see :meth:`hand_back`."""

    def __init__(self) -> None:
        self._fleet: Any = None
        self._index = np.zeros(1 << 16, np.int64)
        self._state = _state_arrays(0)
        self._vehicles: list[Vehicle | None] = []
        self._here: _Here | None = None  # who of them is here, once it has been looked for
        self._references = np.zeros((0, 2), np.int64)
        self._places: dict[VehicleId, int] = {}
        self._free: list[int] = []  # at the end the next: never one beyond those that were taken
        self._batch = 0
        self._take: Any = None
        self._show: Any = None
        self._put: Any = None

    def take(self, readings: Readings) -> "Rest":
        """Take the rows that just go on; returns what else there is to do."""
        n, flags = len(readings), readings.whole[:, 4]
        if self._fleet is None:
            return Rest(left=list(range(n)))
        self._batch += 1
        left = np.empty(n, np.int64)
        rows = (readings.whole, readings.numbers, readings.arrivals_us)
        addresses = readings.addresses
        unusual = self._take(
            self._fleet, self._index, self._state, self._batch, addresses, rows, left
        )
        looks = ((flags & TO_LOOK != 0) & (left != LEFT)).nonzero()[0].tolist()
        if not unusual:
            return Rest(looks)
        return Rest(looks, *((left == done).nonzero()[0].tolist() for done in RESTS))

    def show(self, now_us: int, wanted: int) -> tuple[AttitudeRows | None, AbstractSet[VehicleId]]:
        """What is published at a tick, and of which vehicles nothing else is to be said."""
        if self._here is None:
            self._here = _Here.of(self._vehicles)
        addresses, places, known = self._here
        n = len(addresses)
        if not n:
            return None, known
        done = np.empty(n, np.int64)
        rows = (np.empty((n, ROW_WHOLE), np.int64), np.empty((n, NUMBERS)))
        shown = (*rows, np.empty((n, READINGS)))
        references = self._references
        count = self._show(
            self._fleet, places, self._state, references, now_us, wanted, done, shown
        )
        more = (done == MORE).nonzero()[0].tolist()
        vehicles = addresses
        if count < n:
            vehicles = [addresses[k] for k in (done == SHOWN).nonzero()[0].tolist()]
        found = AttitudeRows(vehicles, *(each[:count] for each in shown)) if count else None
        return found, known - {addresses[k] for k in more} if more else known

    def has(self, address: VehicleId) -> bool:
        """Whether a vehicle's numbers are here."""
        return address in self._places

    def take_over(self, vehicle: Vehicle) -> None:
        """Take a vehicle's numbers, if it just goes on."""
        numbers = vehicle.numbers()
        lent = None if numbers is None else vehicle.estimator.lend()
        if numbers is None or lent is None:
            return
        if not self._free:
            self._grow(lent.inside)
        place = self._places[vehicle.address] = self._free.pop()
        self._vehicles[place] = vehicle
        self._references[place] = [NUMBER_OF_WORD[word] for word in lent.norths]
        self._here = None
        self._put(self._fleet, place, lent.inside)
        self._index[_number(vehicle.address)] = place + 1
        state, reals, left_in, waiting = self._state
        here_deg = lent.here_deg or (inf, inf)
        state[place, :SOURCE], reals[place, :LEAST_HEADING] = numbers
        state[place, SOURCE:WAITING] = (
            lent.source,
            lent.minds_gaps,
            lent.knows_north,
            lent.has_rates,
        )
        state[place, WAITING:] = len(lent.reports), lent.minds_places
        reals[place, LEAST_HEADING:] = lent.least_heading_rad, *here_deg
        left_in[place] = 0
        for k, (time_us, velocity, *others) in enumerate(lent.reports):
            waiting[place, k] = time_us, *velocity, *others

    def tell(self, address: VehicleId) -> None:
        """Have a vehicle know its numbers, for whoever changes nothing that is kept here."""
        place = self._places.get(address)
        if place is None:
            return
        vehicle = self._vehicles[place]
        assert vehicle is not None
        state, reals, _, waiting = self._state
        vehicle.resume(state[place, :SOURCE].tolist(), reals[place, :LEAST_HEADING].tolist())
        reports = waiting[place, : state[place, WAITING]].tolist()
        vehicle.estimator.take_back(
            tuple(map(_report, reports)), has_rates=bool(state[place, HAS_RATES])
        )

    def hand_back(self, address: VehicleId) -> None:
        """Give a vehicle its numbers back, before anybody else uses it."""
        self.tell(address)
        place = self._places.pop(address, None)
        if place is not None:
            self._index[_number(address)] = 0
            self._free.append(place)
            self._vehicles[place] = self._here = None

    def _grow(self, inside: Any) -> None:
        """Make places for as many vehicles again, and bind the steps at the first."""
        n = len(self._vehicles)
        grown = _state_arrays(max(LEAST_PLACES, 2 * n))
        for before, after in zip(self._state, grown, strict=True):
            after[:n] = before
        self._state = grown
        more = len(grown[0]) - n
        self._vehicles += [None] * more
        self._references = np.vstack((self._references, np.zeros((more, 2), np.int64)))
        self._free += range(n + more - 1, n - 1, -1)
        if self._fleet is None:
            arguments = argument_types(_typeof(inside))
            self._take, self._show, self._put = (
                direct(kernel, arguments[kernel]) for kernel in (take_rows, show_rows, put)
            )
            self._fleet = direct(new_fleet, arguments[new_fleet])(inside)


def rehearse(estimator: Estimator) -> None:
    """Compile or load the kernels for such an estimator, if there is compiled code."""
    inside = estimator.inside
    if inside is not None:
        for kernel, arguments in argument_types(_typeof(inside)).items():
            direct(kernel, arguments)


def _number(address: VehicleId) -> int:
    return address.system_id << 8 | address.component_id


def _report(numbers: list[float]) -> VelocitySample:
    time_us, x, y, z, has_vertical, sigma_m_s, late_sigma_s = numbers
    return VelocitySample(int(time_us), (x, y, z), has_vertical != 0.0, sigma_m_s, late_sigma_s)


def _state_arrays(vehicles: int) -> tuple[Whole, Floats, Whole, Floats]:
    whole = np.zeros((vehicles, STATE_SIZE), np.int64)
    waiting = np.zeros((vehicles, MOST_WAITING, REPORT_SIZE))
    return whole, np.zeros((vehicles, STATE_NUMBERS)), np.zeros(vehicles, np.int64), waiting


@cache
def argument_types(inside: Any) -> dict[Any, tuple[Any, ...]]:
    """What numba calls the types of the kernels' arguments; a handle's is ``inside``."""
    fleet, whole = _types.ListType(inside), _types.int64
    numbers, two = _typeof(np.zeros(0, np.int64)), _typeof(np.zeros((0, 0), np.int64))
    state, reals = _typeof(_state_arrays(0)), _typeof(np.zeros((0, 0)))
    rows = _types.Tuple((two, reals, numbers))
    return {
        new_fleet: (inside,),
        put: (fleet, whole, inside),
        take_rows: (fleet, numbers, state, whole, numbers, rows, numbers),
        show_rows: (
            *(fleet, numbers, state, two, whole, whole, numbers),
            _types.Tuple((two, reals, reals)),
        ),
    }
