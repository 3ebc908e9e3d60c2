"""Readings that just go on with what came before them, as nearly all do, in compiled code.

:class:`~drivers.samples.intake.Intake` holds the rules for every reading, in Python. What they come
to for one that is sound and follows sound ones in time is here: a small part of them, in a
hundredth of the time: clocks and sensors are judged by the same functions. It works on rows of
numbers that the parts of an intake hand over and go on from. A reading that is anything else is
left alone, and nothing has changed then.
"""

from typing import Any

import numpy as np

from drivers.samples.fresh_field import is_fresh
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
from drivers.samples.vehicle_clock import CLOCK_SIZE, goes_on, place
from estimator.compilation.compiled import inlined
from estimator.types import ZERO_VEC3, Vec3

# Arrays of int64 and float64; what compiled code reads there are its own numbers, not numpy's.
Whole = Any
Floats = Any

# Of a vehicle: when somebody's attitude was given, when it was looked into what vehicle it is, when
# anything was heard, the time of the last IMU sample, what receiver and filter said of themselves.
GIVEN, VERSION, HEARD, LAST_IMU, NAVIGATION = 0, 1, 2, 3, 4
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
def take_field(whole: Whole, numbers: Floats, mag: Vec3, time_us: int) -> bool:
    """Whether a field is fresh, and remember it if so."""
    if not is_fresh(mag, time_us, three(numbers, FRESH), whole[FRESH_US]):
        return False
    write(numbers, FRESH, mag)
    whole[FRESH_US] = time_us
    return True


@inlined
def arrive(
    clock: Whole, placed: Whole, field: int, is_imu: bool, raw_us: int, arrival_us: int
) -> int:
    """Go on to a message that :func:`goes_on` has let; returns its continuous time."""
    last = (placed[PLACED_TIME], placed[PLACED_BOOT])
    _, time_us, boot_us, _, _, _ = place(clock, field, is_imu, raw_us, arrival_us, last)
    placed[PLACED_TIME], placed[PLACED_BOOT] = time_us, boot_us
    return time_us


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
    faults = whole[FAULTS:]
    if known != GOES_ON or faults[BLIND] != FINE:
        return NOTHING, FINE, 0, 0, False
    if not goes_on(clock, field, raw_us, arrival_us, whole[PLACED_BOOT]):
        return NOTHING, FINE, 0, 0, False
    why = judge(faults, numbers, gyr, acc, mag, raw_us)
    if why != FINE:
        return REFUSED, why, 0, 0, False
    if mag_is_stuck(faults, numbers):
        why, mag = MAG_STUCK, ZERO_VEC3
    time_us = arrive(clock, whole, field, True, raw_us, arrival_us)
    done = TAKEN
    if not 0 <= whole[LOOK] - time_us <= SPACING_US:
        whole[LOOK] = time_us + SPACING_US
        done = TAKEN_TO_LOOK
    boot_us = int(whole[PLACED_BOOT])
    return done, why, time_us, boot_us, take_field(whole, numbers, mag, time_us)


@inlined
def take_other(
    clock: Whole, placed: Whole, field: int, raw_us: int, arrival_us: int
) -> tuple[int, int]:
    """A message that is no IMU's. Returns what it has done, and its continuous time."""
    if not goes_on(clock, field, raw_us, arrival_us, placed[PLACED_BOOT]):
        return NOTHING, 0
    return TAKEN, arrive(clock, placed, field, False, raw_us, arrival_us)


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
