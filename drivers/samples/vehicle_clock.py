"""The vehicle's own time, made continuous.

An autopilot stamps its messages with up to three clocks: ``time_usec`` of the
IMU messages, ``time_boot_ms`` of most others, and the time of GPS_RAW_INT.
They are usually one clock, but old firmware wraps the first at 2^32 us, some
run a constant 2.3 to 2.6 s apart, and the last may be Unix time. Clocks start
anew when the vehicle reboots, and leap when a recorder joins two sessions.

``VehicleClock`` puts all of that on one line of time: that of the IMU
messages, with reboots and jumps cut out. Nothing here reads the host's clock:
arrival times come in with the data. They tell a gap from a jump, and a clock
that keeps no time at all (milliseconds counted as microseconds, or the reverse;
one that crawls) from one that does.

The rules are compiled, for one message at a time and for those of many vehicles
(:mod:`drivers.samples.going_on`). What they know of a vehicle's clocks is a row of whole numbers.
"""

from enum import IntEnum
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np

from drivers.value import Value
from estimator.compilation.compiled import compiled, inlined, is_compiled_code
from estimator.compilation.direct import direct, types_of
from estimator.reasons import Reason

SECOND_US = 1_000_000

REORDERED_US = 1 * SECOND_US  # further back than links reorder: the clock began anew
JUMP_US = 5 * SECOND_US  # real gaps agree with arrivals within 4 s (p99 of late arrivals)
LATENESS_LIMIT_US = 30 * SECOND_US  # a sample may be held back this long; seen: 14 s
LOST_TIME_US = 60 * SECOND_US  # arrivals say that much more time passed: another session
ORDINARY_STEP_US = 2 * SECOND_US  # a step this short is the same session, whatever arrivals say
CLOCK_DRIFT = 0.005  # boot clocks ran up to 136 ms a minute slow
# Off pace is a clock that for two seconds in a row was so many times too fast or too slow. A burst
# makes up for the silence before it, so it is no pace. None of 46 recorded logs has such seconds.
OFF_PACE = 5
OFF_SECONDS = 2
# Two vehicles with one address send in turns: their times are two lines, each of which goes on.
ALIVE_US = 1 * SECOND_US
BESIDE_US = SECOND_US // 2
CUT_STEP_US = 20_000  # put in the place of what a reboot or a jump cut out

OFFSET_SAMPLES = 64  # enough for a median through 0.4 s of jitter
SAME_CLOCK_US = 1 * SECOND_US  # closer clocks are one clock; others were 2.3 s apart or more

WRAP_32_US = 2**32
WRAPS_US = (WRAP_32_US, WRAP_32_US * 1000, 0)  # of the clocks below; 0: it has none
MOST_US = 1 << 53  # 285 years: a time beyond is garbage, and counts as this


class TimeField(IntEnum):
    """Which of the vehicle's clocks a message carries."""

    TIME_USEC = 0
    BOOT_MS = 1
    GPS = 2


# An array of int64, or a list in plain Python.
Whole = Any
CLOCKS = len(TimeField)
IMUS_CLOCK, BOOT_CLOCK, RECEIVERS_CLOCK = map(int, TimeField)

# Of a vehicle: which clock the line of time is made of, continuous time less boot time on that, the
# latest continuous time given, which clocks began anew while the line of time may be about to,
PRIMARY, SHIFT, LATEST, WAITING = 0, 1, 2, 3
NO_LINE = -1
# the lines of all clocks, and their offsets from the line of time.
LINES = WAITING + CLOCKS
# Of a line: whether there was a message, what wraps have added, boot time and arrival of the last
# one, the smallest arrival less boot time, with drift,
STARTED, WRAPPED, BOOT, ARRIVAL, FLOOR = 0, 1, 2, 3, 4
# boot time, arrival and lateness at the beginning of this second, boot time and arrival at the end
# of the last one that was in pace, how many in a row were not,
SECOND, PACE, OFF = 5, 8, 10
# and a message that stepped away and waits to be confirmed, and the last of another line: for each
# whether there is one, its boot time and arrival.
CANDIDATE, BESIDE = 11, 14
LINE_SIZE = 17
# Of an offset: how many estimates there are, their median, how many came since that was taken,
# which is the oldest, and the estimates.
SAMPLES, OFFSET_US, SINCE_MEDIAN, OLDEST, RING = 0, 1, 2, 3, 4
OFFSETS = LINES + CLOCKS * LINE_SIZE
OFFSET_SIZE = RING + OFFSET_SAMPLES
CLOCK_SIZE = OFFSETS + CLOCKS * OFFSET_SIZE

# What becomes of a message: it has a place in time, or there is a reason why not.
PLACED, STEP, CONFLICT, OFF_ITS_PACE, NO_CLOCK, DUPLICATE, OUT_OF_ORDER = 0, 1, 2, 3, 4, 5, 6
# How a clock was reset.
NO_RESET, REBOOT, JUMP = 0, 1, 2


class Reset(NamedTuple):
    """A clock began anew or leapt; ``step_us`` is how far it moved, signed."""

    reason: Literal["reboot", "jump"]
    step_us: int


class Placed(Value, frozen=True):
    """A message's place in time: continuous, and on the vehicle's own unwrapped clock.

    A reset is known only when a second message confirms it; the first, which
    was refused as ``clock_step``, came ``since_reset_us`` before this one.
    """

    time_us: int
    boot_us: int
    reset: Reset | None
    since_reset_us: int = 0


class Refused(Value, frozen=True):
    """Why a message has no place in time."""

    reason: Reason


REFUSALS = {
    STEP: Refused(Reason.CLOCK_STEP),
    CONFLICT: Refused(Reason.ADDRESS_CONFLICT),
    OFF_ITS_PACE: Refused(Reason.CLOCK_PACE),
    NO_CLOCK: Refused(Reason.NO_CLOCK),
    DUPLICATE: Refused(Reason.DUPLICATE),
    OUT_OF_ORDER: Refused(Reason.OUT_OF_ORDER),
}
RESETS: dict[int, Literal["reboot", "jump"]] = {REBOOT: "reboot", JUMP: "jump"}


@inlined
def advance(
    clock: Whole, field: int, raw_us: int, arrival_us: int
) -> tuple[int, int, int, int, int]:
    """One clock's next message: what becomes of it, and its boot time.

    Also how the clock was reset, how far that was, and how long ago. A step that no gap explains
    counts only once the next message agrees with it, so a single garbled time changes nothing.
    """
    line = LINES + field * LINE_SIZE
    if clock[line + STARTED] == 0:
        clock[line + STARTED] = 1
        restart(clock, line, raw_us, arrival_us)
        return PLACED, raw_us, NO_RESET, 0, 0
    boot_us = unwrap(clock, line, WRAPS_US[field], raw_us, arrival_us)
    if goes_on_beside(clock, line, boot_us, arrival_us):
        note(clock, line + BESIDE, boot_us, arrival_us)
        clock[line + CANDIDATE] = 0
        return CONFLICT, boot_us, NO_RESET, 0, 0
    last_us, last_arrival_us = clock[line + BOOT], clock[line + ARRIVAL]
    reason = judge_step(clock, line, boot_us - last_us, arrival_us - last_arrival_us)
    began_us, began_arrival_us = clock[line + CANDIDATE + 1], clock[line + CANDIDATE + 2]
    if reason == NO_RESET:
        if clock[line + CANDIDATE] == 1:  # it was garbled, or is somebody else's
            note(clock, line + BESIDE, began_us, began_arrival_us)
            clock[line + CANDIDATE] = 0
        lost_us, keeps_time_again = accept(clock, line, boot_us, arrival_us)
        return PLACED, boot_us, JUMP if keeps_time_again else NO_RESET, lost_us, 0
    step_us, elapsed_us = boot_us - began_us, max(arrival_us - began_arrival_us, 0)
    if clock[line + CANDIDATE] == 0 or not 0 < step_us <= elapsed_us + JUMP_US:
        note(clock, line + CANDIDATE, boot_us, arrival_us)
        return STEP, boot_us, NO_RESET, 0, 0
    note(clock, line + BESIDE, last_us, last_arrival_us)
    restart(clock, line, began_us, began_arrival_us)
    accept(clock, line, boot_us, arrival_us)
    return PLACED, boot_us, reason, int(began_us - last_us), int(step_us)


@inlined
def note(clock: Whole, at: int, boot_us: int, arrival_us: int) -> None:
    """Remember a message that is not the line's own."""
    clock[at], clock[at + 1], clock[at + 2] = 1, boot_us, arrival_us


@inlined
def restart(clock: Whole, line: int, boot_us: int, arrival_us: int) -> None:
    """Begin a line with a message."""
    clock[line + CANDIDATE] = 0
    clock[line + FLOOR] = arrival_us - boot_us
    begin_second(clock, line, boot_us, arrival_us, 0)
    clock[line + PACE], clock[line + PACE + 1] = boot_us, arrival_us
    clock[line + OFF] = 0
    clock[line + BOOT], clock[line + ARRIVAL] = boot_us, arrival_us


@inlined
def begin_second(clock: Whole, line: int, boot_us: int, arrival_us: int, late_us: int) -> None:
    """Begin another second whose pace is to be compared with the host's."""
    second = line + SECOND
    clock[second], clock[second + 1], clock[second + 2] = boot_us, arrival_us, late_us


@inlined
def unwrap(clock: Whole, line: int, wrap_us: int, raw_us: int, arrival_us: int) -> int:
    """The boot time of a message."""
    boot_us, last_us = raw_us + clock[line + WRAPPED], clock[line + BOOT]
    if wrap_us == 0 or last_us - boot_us < wrap_us // 2:
        return int(boot_us)
    step_us = boot_us + wrap_us - last_us
    is_wrap = last_us - clock[line + WRAPPED] < wrap_us and step_us >= -REORDERED_US
    elapsed_us = arrival_us - clock[line + ARRIVAL]
    if is_wrap and judge_step(clock, line, step_us, elapsed_us) == NO_RESET:
        clock[line + WRAPPED] += wrap_us
        boot_us += wrap_us
    return int(boot_us)


@inlined
def judge_step(clock: Whole, line: int, step_us: int, elapsed_us: int) -> int:
    """What a step of the clock, and of the arrivals, would be."""
    elapsed_us = max(elapsed_us, 0)
    if step_us < -REORDERED_US:
        return REBOOT
    late_us = clock[line + ARRIVAL] - clock[line + BOOT] - clock[line + FLOOR]
    if step_us - elapsed_us > JUMP_US + min(late_us, LATENESS_LIMIT_US):
        return JUMP
    if step_us > ORDINARY_STEP_US and elapsed_us - step_us > LOST_TIME_US:
        return JUMP
    return NO_RESET


@inlined
def is_off_line(clock: Whole, line: int, boot_us: int, arrival_us: int) -> bool:
    """Whether there is another line, and a message does not go on with this one at its pace."""
    step_us, here_us = boot_us - clock[line + BOOT], arrival_us - clock[line + ARRIVAL]
    if clock[line + BESIDE] == 0 or 0 < step_us <= BESIDE_US:
        return False
    return bool(0 <= here_us < ALIVE_US and abs(step_us - here_us) >= BESIDE_US)


@inlined
def goes_on_beside(clock: Whole, line: int, boot_us: int, arrival_us: int) -> bool:
    """Whether a message goes on with another line that keeps this one's pace, not with this.

    A clock that began anew or leapt never comes back to where it was, while it goes on here.
    """
    step_us = boot_us - clock[line + BESIDE + 1]
    elapsed_us = arrival_us - clock[line + BESIDE + 2]
    goes_on = step_us > 0 and abs(step_us - elapsed_us) < BESIDE_US
    return bool(goes_on and is_off_line(clock, line, boot_us, arrival_us))


@inlined
def accept(clock: Whole, line: int, boot_us: int, arrival_us: int) -> tuple[int, bool]:
    """Go on to a message; the time that was lost, if the clock keeps time again since that."""
    if boot_us <= clock[line + BOOT]:
        return 0, False
    elapsed_us = arrival_us - clock[line + ARRIVAL]
    offset_us = arrival_us - boot_us
    if elapsed_us < 0 or elapsed_us - (boot_us - clock[line + BOOT]) > LOST_TIME_US:
        clock[line + FLOOR] = offset_us  # the host's clock was set
    else:
        clock[line + FLOOR] = min(clock[line + FLOOR] + int(CLOCK_DRIFT * elapsed_us), offset_us)
    clock[line + BOOT], clock[line + ARRIVAL] = boot_us, arrival_us
    if 0 <= arrival_us - clock[line + SECOND + 1] < SECOND_US:
        return 0, False
    return compare_pace(clock, line, boot_us, arrival_us)


@inlined
def compare_pace(clock: Whole, line: int, boot_us: int, arrival_us: int) -> tuple[int, bool]:
    """Compare the second that ends with the host's; the time lost if time is kept again.

    A longer time without a message is a gap, which says nothing of the pace.
    """
    step_us = boot_us - clock[line + SECOND]
    elapsed_us = arrival_us - clock[line + SECOND + 1]
    is_fast = step_us - clock[line + SECOND + 2] > OFF_PACE * elapsed_us
    late_us = max(arrival_us - boot_us - clock[line + FLOOR], 0)
    begin_second(clock, line, boot_us, arrival_us, late_us)
    if not 0 < elapsed_us <= ORDINARY_STEP_US:
        return 0, False
    if is_fast or OFF_PACE * step_us < elapsed_us:
        clock[line + OFF] += 1
        return 0, False
    lost_us = boot_us - clock[line + PACE] - (arrival_us - clock[line + PACE + 1])
    keeps_time_again = clock[line + OFF] >= OFF_SECONDS
    clock[line + OFF] = 0
    clock[line + PACE], clock[line + PACE + 1] = boot_us, arrival_us
    return int(lost_us), bool(keeps_time_again)


@inlined
def is_off_pace(clock: Whole, field: int) -> bool:
    """Whether a clock keeps no time, by the host's: its seconds are none."""
    return bool(clock[LINES + field * LINE_SIZE + OFF] >= OFF_SECONDS)


@inlined
def learn_offset(clock: Whole, field: int, sample_us: int) -> int:
    """A clock's constant distance from the line of time, with one more estimate in the median.

    It is exactly 0 (or a whole wrap) if both are one clock.
    """
    o = OFFSETS + field * OFFSET_SIZE
    if clock[o + SAMPLES] == OFFSET_SAMPLES:
        clock[o + RING + clock[o + OLDEST]] = sample_us
        clock[o + OLDEST] = (clock[o + OLDEST] + 1) % OFFSET_SAMPLES
    else:
        clock[o + RING + clock[o + SAMPLES]] = sample_us
        clock[o + SAMPLES] += 1
    n = clock[o + SAMPLES]
    clock[o + SINCE_MEDIAN] += 1
    if n < OFFSET_SAMPLES or clock[o + SINCE_MEDIAN] >= OFFSET_SAMPLES // 4:
        clock[o + SINCE_MEDIAN] = 0
        median_us = int(np.sort(clock[o + RING : o + RING + n])[n // 2])
        whole_us = int(np.rint(median_us / WRAP_32_US)) * WRAP_32_US
        is_same = abs(median_us - whole_us) < SAME_CLOCK_US
        clock[o + OFFSET_US] = whole_us if is_same else median_us
    return int(clock[o + OFFSET_US])


@inlined
def forget_offset(clock: Whole, field: int) -> None:
    """Learn a clock's offset from the beginning."""
    o = OFFSETS + field * OFFSET_SIZE
    for column in (SAMPLES, OFFSET_US, SINCE_MEDIAN, OLDEST):
        clock[o + column] = 0


@inlined
def choose_line(clock: Whole, field: int, raw_us: int, arrival_us: int) -> None:
    """Let the clock of an IMU message make the line of time, if it is to from now on.

    One that takes over does so without a break in time.
    """
    primary = clock[PRIMARY]
    if primary == NO_LINE:
        clock[PRIMARY] = field
        return
    if field == primary or is_off_pace(clock, field):
        return
    if field != IMUS_CLOCK and not is_off_pace(clock, primary):
        return
    old = LINES + primary * LINE_SIZE
    now_us = clock[old + BOOT] + clock[SHIFT] + max(arrival_us - clock[old + ARRIVAL], 0)
    wrapped_us = clock[LINES + field * LINE_SIZE + WRAPPED]
    clock[PRIMARY] = field
    clock[SHIFT] = max(now_us, clock[LATEST]) - raw_us - wrapped_us
    for each in range(CLOCKS):
        forget_offset(clock, each)


@inlined
def time_on_line(clock: Whole, boot_us: int, is_reset: bool, since_reset_us: int) -> int:
    """The continuous time of a message of the clock that the line of time is made of."""
    if is_reset:
        clock[SHIFT] = clock[LATEST] + CUT_STEP_US - (boot_us - since_reset_us)
        for field in range(CLOCKS):
            forget_offset(clock, field)
    for field in range(CLOCKS):
        clock[WAITING + field] = 0
    clock[LATEST] = max(clock[LATEST], boot_us + clock[SHIFT])
    return int(boot_us + clock[SHIFT])


@inlined
def time_beside(clock: Whole, field: int, boot_us: int, arrival_us: int) -> int:
    """The continuous time of a message of another clock."""
    line = LINES + clock[PRIMARY] * LINE_SIZE
    line_now_us = clock[line + BOOT] + max(arrival_us - clock[line + ARRIVAL], 0)
    time_us = boot_us - learn_offset(clock, field, boot_us - line_now_us) + clock[SHIFT]
    if field != RECEIVERS_CLOCK:
        clock[LATEST] = max(clock[LATEST], time_us)
    return int(time_us)


@inlined
def place(
    clock: Whole, field: int, is_imu: bool, raw_us: int, arrival_us: int, last: tuple[int, int]
) -> tuple[int, int, int, int, int, int]:
    """Place a message behind the ``last`` of its stream (continuous and boot time).

    Returns what becomes of it, its continuous and boot time, the reset of its clock, how far that
    stepped, and how long ago. With a reset the last counts no more, of any stream of that clock.
    """
    if is_imu:
        choose_line(clock, field, raw_us, arrival_us)
    if clock[PRIMARY] == NO_LINE:
        return NO_CLOCK, 0, 0, NO_RESET, 0, 0
    why, boot_us, reset, step_us, since_us = advance(clock, field, raw_us, arrival_us)
    if why == PLACED and is_off_pace(clock, field):
        why = OFF_ITS_PACE
    if why != PLACED:
        return why, 0, boot_us, NO_RESET, 0, 0
    if reset != NO_RESET:
        forget_offset(clock, field)
        clock[WAITING + field] = 1
    if field == clock[PRIMARY]:
        time_us = time_on_line(clock, boot_us, reset != NO_RESET, since_us)
    elif clock[WAITING + field] == 1:
        return NO_CLOCK, 0, boot_us, reset, step_us, since_us
    else:
        time_us = time_beside(clock, field, boot_us, arrival_us)
    last_us, last_boot_us = last
    if reset == NO_RESET:
        if boot_us == last_boot_us:
            why = DUPLICATE
        elif boot_us < last_boot_us:
            why = OUT_OF_ORDER
        time_us = max(time_us, last_us + 1)  # a learnt offset moved
    return why, time_us, boot_us, reset, step_us, since_us


@inlined
def goes_on(clock: Whole, field: int, raw_us: int, arrival_us: int, last_boot_us: int) -> bool:
    """Whether :func:`place` will take a message without a reset, as it just goes on in time.

    ``last_boot_us`` is of the one before it in its stream. False for some others that are taken.
    """
    line = LINES + field * LINE_SIZE
    boot_us = raw_us + clock[line + WRAPPED]
    if clock[PRIMARY] == NO_LINE or clock[WAITING + field] == 1 or boot_us <= last_boot_us:
        return False
    if clock[line + STARTED] == 0 or clock[line + OFF] != 0:
        return False
    is_ordinary = 0 <= boot_us - clock[line + BOOT] <= ORDINARY_STEP_US
    return bool(is_ordinary and not is_off_line(clock, line, boot_us, arrival_us))


def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`place_message` is called with."""
    return types_of(np.zeros(0, np.int64), 0, True, *(0,) * 4)


@compiled(types=argument_types)
def place_message(
    clock: Whole,
    field: int,
    is_imu: bool,
    raw_us: int,
    arrival_us: int,
    last_us: int,
    last_boot_us: int,
) -> tuple[int, int, int, int, int, int]:
    """See :func:`place`; plain numbers cost the least to hand over."""
    return place(clock, field, is_imu, raw_us, arrival_us, (last_us, last_boot_us))


class VehicleClock:
    """All clocks of one vehicle on one continuous line of time.

    The line is ``time_usec`` of the IMU messages, or ``time_boot_ms`` for a
    vehicle that sends nothing else. Times of the other clocks are moved onto
    it by their learnt offset; each restarts when it or the line is reset. What comes by a
    clock that is off pace is refused, and an IMU message of another clock makes the line then.
    """

    def __init__(self) -> None:
        has_code = is_compiled_code()
        self.whole: Whole = np.zeros(CLOCK_SIZE, np.int64) if has_code else [0] * CLOCK_SIZE
        self.whole[PRIMARY] = NO_LINE
        # of each stream continuous and boot time of the last that was placed
        self._streams: dict[tuple[TimeField, str], tuple[int, int]] = {}
        self._forgotten: set[TimeField] = set()  # whose streams were, see take_forgotten

    def imu(self, message: str, field: TimeField, raw_us: int, arrival_us: int) -> Placed | Refused:
        """Place an IMU message; within one ``message`` the times given only ever grow."""
        return self._place(message, field, True, raw_us, arrival_us)

    def other(
        self, message: str, field: TimeField, raw_us: int, arrival_us: int
    ) -> Placed | Refused:
        """Place another message, once an IMU message has started the line of time."""
        return self._place(message, field, False, raw_us, arrival_us)

    def _place(
        self, message: str, field: TimeField, is_imu: bool, raw_us: int, arrival_us: int
    ) -> Placed | Refused:
        step = _compiled()
        last = self._streams.get((field, message), NOTHING_BEFORE)
        raw_us, arrival_us = min(raw_us, MOST_US), min(arrival_us, MOST_US)
        why, time_us, boot_us, reset, step_us, since_us = step(
            self.whole, field, is_imu, raw_us, arrival_us, *last
        )
        if reset != NO_RESET:
            self._forgotten.add(field)
            self._streams = {key: last for key, last in self._streams.items() if key[0] != field}
        if why != PLACED:
            return REFUSALS[why]
        self._streams[field, message] = time_us, boot_us
        found = Reset(RESETS[reset], step_us) if reset != NO_RESET else None
        return Placed(time_us, boot_us, found, since_us)

    def take_forgotten(self) -> set[TimeField]:
        """The clocks whose streams were forgotten since the last call, as they began anew."""
        forgotten, self._forgotten = self._forgotten, set()
        return forgotten


NOTHING_BEFORE = (-(1 << 62), -(1 << 62))


@cache
def _compiled() -> Any:
    return direct(place_message, argument_types())
