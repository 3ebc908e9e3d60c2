"""The steps of compiled code that take and show many vehicles' rows at a time.

See :mod:`service.usual_vehicles`.
"""

from math import degrees, isfinite, pi
from typing import Any

import numba
import numpy as np

from drivers.mavlink.usual_kinds import (
    ATTITUDE,
    FRESH,
    GIVES,
    IS_THERE,
    LOCAL_POSITION,
    NO_DATA,
    SILENT,
)
from estimator.aiding.trail import OLDEST_S
from estimator.compilation.compiled import compiled, inlined
from estimator.geometry.frames import euler_rad
from estimator.live.interval import is_gap
from estimator.live.refusal import FINE, RATE_LIMIT_RAD_S, fault_of
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
from estimator.types import ZERO_VEC3, Vec3
from service.attitude_rows import HAS_MAG as SHOWN_HAS_MAG
from service.attitude_rows import SAMPLE_US, SHOWN_NUMBERS
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
from service.health import LATE_MINIMUM_US, State, is_left_out, late_after_us
from service.host_clock import HostClock, Offsets, observe
from service.imu_choice import STAND_IN_GAP_US, longest_silence_us
from service.intervals import CHECKED_EVERY, MEDIAN_EVERY, OTHER_CLOCK_US, PERIODS_KEPT
from service.showing import is_due, shown_at
from service.usual_columns import (
    ARRIVAL,
    AT,
    ATTITUDES,
    BOOT,
    CHECK,
    CHOSEN,
    CHOSEN_US,
    CLOCK_AT,
    COMPARE,
    DOUBT,
    EVEN,
    HAS_MAG,
    HAS_RATES,
    HEARD,
    KNOWS_NORTH,
    LEFT,
    LONGEST_SILENCE,
    LOOK_US,
    MEDIAN,
    MINDS_GAPS,
    OFFSET,
    PERIODS,
    RATES_US,
    READING,
    RING,
    RIVAL,
    RIVAL_SAMPLES,
    RIVAL_SINCE,
    RIVAL_US,
    SAMPLES,
    SHOWN_SAMPLES,
    SHOWN_US,
    SOURCE,
    SPANS,
    TAKEN,
    TIME,
    USES_RATES,
    WINDOW,
    WORST_GAP,
    Floats,
    Whole,
)
from service.usual_reports import is_here, reaches, take_due, take_velocity

# Of a vehicle at a tick: nothing is wanted of it, it is shown, or there is more to do.
UNWANTED, SHOWN, MORE = 0, 1, 2
# Which are wanted at a tick.
NONE, WOKEN, DUE, ALL = 0, 1, 2, 3
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
            goes_on, _ = advance_aided(inside, report, row[KNOWS_NORTH] == 1, True)
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
    shown: tuple[Whole, Floats],
) -> int:
    """Write what is published of the vehicles at ``places``; returns how many those are.

    ``done`` says what has become of each. ``references`` has, by place, what a heading is measured
    from, with one and without. Those that are shown count it.
    """
    state_whole, state_numbers = state[:2]
    out_whole, out = shown
    n = 0
    for k in range(len(places)):
        row, reals = state_whole[places[k]], state_numbers[places[k]]
        silence_us, median_us = now_us - row[ARRIVAL], float(row[MEDIAN])
        if silence_us >= late_after_us(median_us):
            is_ours = is_left_out(silence_us, now_us - row[HEARD], median_us)
            done[k] = UNWANTED if wanted == WOKEN or (wanted != ALL and is_ours) else MORE
            continue
        done[k] = UNWANTED
        is_new = is_due(row[SAMPLES] != row[SHOWN_SAMPLES], now_us - row[SHOWN_US])
        if wanted == NONE or (wanted != ALL and not is_new):
            continue
        done[k] = MORE
        clock, last_us = clock_of(row, reals), (row[TIME], row[ARRIVAL])
        time_us, age_us = shown_at(clock, last_us, median_us, now_us)
        _, moved, figures, has_heading = publish(fleet[places[k]], time_us, row[SOURCE])
        if not is_finite(moved, figures):
            continue
        done[k], whole = SHOWN, out_whole[n]
        whole[UNIX_US], whole[BOOT_US] = now_us, row[BOOT] + time_us - row[TIME]
        whole[AGE_US], whole[SEQUENCE], whole[STATE] = max(0, age_us), row[ATTITUDES], RUNNING
        whole[REFERENCE] = references[places[k], 0 if has_heading else 1]
        write_shown(out[n], moved, figures)
        whole[SAMPLE_US], whole[SHOWN_HAS_MAG] = row[TIME], row[HAS_MAG]
        for i in range(NUMBERS, SHOWN_NUMBERS):
            out[n, i] = reals[READING + i - NUMBERS]
        row[ATTITUDES] += 1
        row[SHOWN_SAMPLES], row[SHOWN_US] = row[SAMPLES], now_us
        n += 1
    return n


@inlined
def write_shown(row: Floats, moved: Any, figures: Any) -> None:
    """The numbers of an attitude, in the order of its record's fields."""
    q, rate, bias, error, error_rate, gain = moved
    euler = euler_rad(q)
    for i in range(4):
        row[i] = q[i]
    for i in range(3):
        row[4 + i], row[7 + i], row[10 + i] = degrees(euler[i]), rate[i], bias[i]
    row[13], row[14], row[15] = error, error_rate, gain
    row[16], row[17] = figures[0], figures[1]
    inclination, heading = figures[2], figures[3]
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
