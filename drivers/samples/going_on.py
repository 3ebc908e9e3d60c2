"""Readings that just go on with what came before them, as nearly all do, in compiled code.

:class:`~drivers.samples.intake.Intake` holds the rules for every reading, in Python. What they come
to for one that is sound and follows sound ones in time is here: a small part of them, in a
hundredth of the time. It works on rows of numbers that the parts of an intake hand over
(``numbers``) and go on from (``resume``), to the same bits. A reading that is anything else is left
alone, and nothing has changed then.
"""

from typing import Any

import numpy as np

from drivers.samples.fresh_field import REPEAT_US
from drivers.samples.navigation import WORDS
from drivers.samples.plausibility import SPACING_US
from drivers.samples.sensor_faults import (
    BLIND,
    FINE,
    MAG_STUCK,
    NUMBERS_SIZE,
    WHOLE_SIZE,
    ZERO_ACC,
    is_equal,
    judge,
    mag_is_stuck,
    three,
    write,
)
from drivers.samples.vehicle_clock import (
    ALIVE_US,
    BESIDE_US,
    CLOCK_DRIFT,
    KEPT_LINES,
    KEPT_OFFSETS,
    LINE_SIZE,
    LOST_TIME_US,
    OFF_PACE,
    OFFSET_SAMPLES,
    OFFSET_SIZE,
    ORDINARY_STEP_US,
    SAME_CLOCK_US,
    SECOND_US,
    WRAP_32_US,
)
from estimator.compilation.compiled import inlined
from estimator.types import ZERO_VEC3, Vec3

# Arrays of int64 and float64; what compiled code reads there are its own numbers, not numpy's.
Whole = Any
Floats = Any

# A vehicle's clocks: which of the first two the line of time is made of, its shift and latest time,
# then the lines of all three and the offsets of the latter two.
PRIMARY, SHIFT, LATEST, LINES = 0, 1, 2, 3
OFFSETS = LINES + len(KEPT_LINES) * LINE_SIZE
CLOCK_SIZE = OFFSETS + len(KEPT_OFFSETS) * OFFSET_SIZE
IMUS_CLOCK, BOOT_CLOCK, RECEIVERS_CLOCK = 0, 1, 2
# Columns of a line, of which the first says that it can go on,
WRAPPED, BOOT, ARRIVAL, FLOOR, SECOND, PACE, BESIDE = 1, 2, 3, 4, 5, 8, 10
# and of the offset, of which the first says how many estimates it is made of.
OFFSET_US, SINCE_MEDIAN, OLDEST, RING = 1, 2, 3, 4

# Of a vehicle: when somebody's attitude was given, when anything was heard, the time of the last
# IMU sample, and what its receiver and filter said of themselves.
GIVEN, HEARD, LAST_IMU, NAVIGATION = 0, 1, 2, 3
SAID_SIZE = NAVIGATION + WORDS
# A stream's last message, in continuous and boot time. An IMU stream's other columns:
PLACED_TIME, PLACED_BOOT = 0, 1
OTHER_SIZE = 2
LOOK, FRESH_US, FAULTS = 2, 3, 4
STREAM_SIZE = FAULTS + WHOLE_SIZE
# and its numbers that are not whole: those of the faults, and the last fresh field.
FRESH = NUMBERS_SIZE
STREAM_NUMBERS = FRESH + 3
# What is known of a stream: nothing, that there is one, and where it goes on.
UNKNOWN, THERE, GOES_ON = 0, 1, 2

# What a reading has done.
NOTHING, TAKEN, TAKEN_TO_LOOK, REFUSED = 0, 1, 2, 3  # the third is to be looked at more closely


@inlined
def keeps_pace(clock: Whole, line: int, boot_us: int, arrival_us: int) -> int:
    """Whether a second ends that was as long by both clocks; -1 if it was not, 0 if none ends."""
    if 0 <= arrival_us - clock[line + SECOND + 1] < SECOND_US:
        return 0
    step_us = boot_us - clock[line + SECOND]
    elapsed_us = arrival_us - clock[line + SECOND + 1]
    if not 0 < elapsed_us <= ORDINARY_STEP_US:
        return 2  # a gap, which says nothing
    is_fast = step_us - clock[line + SECOND + 2] > OFF_PACE * elapsed_us
    return -1 if is_fast or OFF_PACE * step_us < elapsed_us else 1


@inlined
def floor_after(clock: Whole, line: int, boot_us: int, arrival_us: int) -> int:
    """The smallest arrival less boot time, with drift, once a message has come."""
    elapsed_us = arrival_us - clock[line + ARRIVAL]
    step_us = boot_us - clock[line + BOOT]
    offset_us = arrival_us - boot_us
    if elapsed_us < 0 or elapsed_us - step_us > LOST_TIME_US:
        return offset_us
    return int(min(clock[line + FLOOR] + int(CLOCK_DRIFT * elapsed_us), offset_us))


@inlined
def accept(clock: Whole, line: int, boot_us: int, arrival_us: int, floor_us: int, end: int) -> None:
    """Go on to a message; ``end`` is what :func:`keeps_pace` says."""
    clock[line + FLOOR] = floor_us
    clock[line + BOOT], clock[line + ARRIVAL] = boot_us, arrival_us
    if end == 0:
        return
    clock[line + SECOND], clock[line + SECOND + 1] = boot_us, arrival_us
    clock[line + SECOND + 2] = max(arrival_us - boot_us - floor_us, 0)
    if end == 1:
        clock[line + PACE], clock[line + PACE + 1] = boot_us, arrival_us


@inlined
def is_fresh(whole: Whole, numbers: Floats, mag: Vec3, time_us: int) -> bool:
    """Whether a field is neither zero nor a repetition, and remember it if so."""
    if is_equal(mag, ZERO_VEC3):
        return False
    if is_equal(mag, three(numbers, FRESH)) and 0 <= time_us - whole[FRESH_US] < REPEAT_US:
        return False
    write(numbers, FRESH, mag)
    whole[FRESH_US] = time_us
    return True


@inlined
def reach(
    clock: Whole, placed: Whole, field: int, raw_us: int, arrival_us: int
) -> tuple[bool, int, int, int]:
    """Whether a message goes on by one of the clocks, behind the one before it in its stream.

    Also its boot time, what :func:`keeps_pace` says and the floor behind it. Nothing changes yet.
    """
    line = LINES + field * LINE_SIZE
    boot_us = raw_us + clock[line + WRAPPED]
    step_us, here_us = boot_us - clock[line + BOOT], arrival_us - clock[line + ARRIVAL]
    goes_on = clock[line] == 1 and 0 <= step_us <= ORDINARY_STEP_US
    if not goes_on or boot_us <= placed[PLACED_BOOT]:
        return False, boot_us, 0, 0
    is_off = 0 <= here_us < ALIVE_US and abs(step_us - here_us) >= BESIDE_US
    if clock[line + BESIDE] == 1 and (is_off or step_us > BESIDE_US):
        return False, boot_us, 0, 0
    if field != clock[PRIMARY]:
        # another clock finds its place by the line of time; that of IMUs makes the line
        goes_on = field != IMUS_CLOCK and clock[LINES + clock[PRIMARY] * LINE_SIZE] == 1
    else:
        goes_on = boot_us + clock[SHIFT] > placed[PLACED_TIME]
    floor_us = floor_after(clock, line, boot_us, arrival_us)
    end = keeps_pace(clock, line, boot_us, arrival_us) if step_us > 0 else 0
    return bool(goes_on), boot_us, end, floor_us


@inlined
def arrive(
    clock: Whole,
    placed: Whole,
    field: int,
    boot_us: int,
    arrival_us: int,
    floor_us: int,
    end: int,
) -> int:
    """Go on to a message that :func:`reach` has let; returns its continuous time."""
    line = LINES + field * LINE_SIZE
    is_primary = field == clock[PRIMARY]
    # by the line of time as it was before, which is another line for whoever comes beside it
    first = LINES + clock[PRIMARY] * LINE_SIZE
    line_now_us = clock[first + BOOT] + max(arrival_us - clock[first + ARRIVAL], 0)
    if boot_us > clock[line + BOOT]:  # others of the same millisecond came before
        accept(clock, line, boot_us, arrival_us, floor_us, end)
    time_us = boot_us + clock[SHIFT]
    if not is_primary:
        time_us -= offset_after(clock, field, boot_us - line_now_us)
    if field != RECEIVERS_CLOCK:
        clock[LATEST] = max(clock[LATEST], time_us)
    time_us = max(time_us, placed[PLACED_TIME] + 1)  # a learnt offset moved
    placed[PLACED_TIME], placed[PLACED_BOOT] = time_us, boot_us
    return int(time_us)


@inlined
def take_imu(
    clock: Whole,
    field: int,
    stream: tuple[int, Whole, Floats],
    raw_us: int,
    arrival_us: int,
    vectors: tuple[Vec3, Vec3, Vec3],
) -> tuple[int, int, int, int, bool]:
    """An IMU reading by one of the two clocks, of finite numbers.

    Returns what it has done, why it was refused or its field is not used, its continuous and boot
    time, and whether its field is fresh.
    """
    known, whole, numbers = stream
    gyr, acc, mag = vectors
    if known != UNKNOWN and is_equal(acc, ZERO_VEC3):
        return REFUSED, ZERO_ACC, 0, 0, False
    goes_on, boot_us, end, floor_us = reach(clock, whole, field, raw_us, arrival_us)
    faults = whole[FAULTS:]
    if known != GOES_ON or not goes_on or end < 0 or faults[BLIND] != FINE:
        return NOTHING, FINE, 0, boot_us, False
    why = judge(faults, numbers, gyr, acc, mag, raw_us)
    if why != FINE:
        return REFUSED, why, 0, boot_us, False
    if mag_is_stuck(faults, numbers):
        why, mag = MAG_STUCK, ZERO_VEC3
    time_us = arrive(clock, whole, field, boot_us, arrival_us, floor_us, end)
    done = TAKEN
    if not 0 <= whole[LOOK] - time_us <= SPACING_US:
        whole[LOOK] = time_us + SPACING_US
        done = TAKEN_TO_LOOK
    return done, why, time_us, boot_us, is_fresh(whole, numbers, mag, time_us)


@inlined
def take_other(
    clock: Whole, placed: Whole, field: int, raw_us: int, arrival_us: int
) -> tuple[int, int]:
    """A message that is no IMU's. Returns what it has done, and its continuous time."""
    goes_on, boot_us, end, floor_us = reach(clock, placed, field, raw_us, arrival_us)
    if not goes_on or end < 0:
        return NOTHING, 0
    return TAKEN, arrive(clock, placed, field, boot_us, arrival_us, floor_us, end)


@inlined
def offset_after(clock: Whole, field: int, sample_us: int) -> int:
    """A clock's offset from the line of time, with one more estimate in the median."""
    o = OFFSETS + (field - BOOT_CLOCK) * OFFSET_SIZE
    is_full = clock[o] == OFFSET_SAMPLES
    at = clock[o + OLDEST] if is_full else clock[o]
    clock[o + RING + at] = sample_us
    if is_full:
        clock[o + OLDEST] = (at + 1) % OFFSET_SAMPLES
    else:
        clock[o] += 1
    n = clock[o]
    clock[o + SINCE_MEDIAN] += 1
    if n < OFFSET_SAMPLES or clock[o + SINCE_MEDIAN] >= OFFSET_SAMPLES // 4:
        clock[o + SINCE_MEDIAN] = 0
        median_us = np.sort(clock[o + RING : o + RING + n])[n // 2]
        whole_us = int(np.rint(median_us / WRAP_32_US)) * WRAP_32_US
        is_same = abs(median_us - whole_us) < SAME_CLOCK_US
        clock[o + OFFSET_US] = whole_us if is_same else median_us
    return int(clock[o + OFFSET_US])


class Rows:
    """The numbers of many intakes' clocks, IMU streams and other streams; one row each."""

    def __init__(self, vehicles: int, imus: int, others: int) -> None:
        self.clocks = np.zeros((vehicles, CLOCK_SIZE), np.int64)
        self.said = np.zeros((vehicles, SAID_SIZE), np.int64)
        self.doubts = np.ones(vehicles)  # of the filter's velocity
        self.others = np.zeros((vehicles * others, OTHER_SIZE), np.int64)
        self.whole = np.zeros((vehicles * imus, STREAM_SIZE), np.int64)
        self.numbers = np.zeros((vehicles * imus, STREAM_NUMBERS))
        # what is here, and not in an intake
        self.has_clock = np.zeros(vehicles, np.bool_)
        self.has_other = np.zeros(vehicles * others, np.bool_)
        self.has_imu = np.zeros(vehicles * imus, np.int64)  # or what else is known of it

    @property
    def arrays(self) -> tuple[Any, ...]:
        """All of it, as compiled code takes it."""
        return (
            self.clocks,
            self.said,
            self.doubts,
            self.others,
            self.whole,
            self.numbers,
            self.has_clock,
            self.has_other,
            self.has_imu,
        )
