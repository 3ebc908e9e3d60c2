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
"""

from collections import deque
from enum import Enum
from itertools import chain
from typing import Literal, NamedTuple

import msgspec

from drivers.value import Value
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


class TimeField(Enum):
    """Which of the vehicle's clocks a message carries; the value is its wrap in us, if any."""

    TIME_USEC = WRAP_32_US
    BOOT_MS = WRAP_32_US * 1000
    GPS = None

    __hash__ = object.__hash__  # each is one object; Enum's own is a Python function


# The clocks that :mod:`drivers.samples.going_on` follows, and the numbers of a line and an offset.
KEPT_LINES = (TimeField.TIME_USEC, TimeField.BOOT_MS, TimeField.GPS)
KEPT_OFFSETS = KEPT_LINES[1:]
LINE_SIZE = 11
OFFSET_SIZE = 4 + OFFSET_SAMPLES


class Reset(NamedTuple):
    """A clock began anew or leapt; ``step_us`` is how far it moved, signed."""

    reason: Literal["reboot", "jump"]
    step_us: int


class Unwrapped(Value, frozen=True):
    """An unwrapped clock value; a reset was ``since_reset_us`` ago, at the message before."""

    boot_us: int
    reset: Reset | None
    since_reset_us: int = 0


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


class ClockLine:
    """One clock of one vehicle: unwrapped, with reboots and jumps told from gaps.

    A step that no gap explains counts only once the next message agrees with
    it, so a single garbled time changes nothing.
    """

    def __init__(self, wrap_us: int | None) -> None:
        self._wrap_us = wrap_us
        self.wrapped_us = 0  # what its wraps have added
        self._started = False
        self._candidate: tuple[int, int] | None = None
        self._beside: tuple[int, int] | None = None  # the last of another line
        self.is_beside = False  # the message that was not taken goes on with that other line
        self._floor_us = 0  # smallest arrival - boot, with drift
        self._second = (0, 0, 0)  # boot, arrival and lateness at the beginning of this second
        self._in_pace = (0, 0)  # boot and arrival at the end of the last second that was in pace
        self._off_seconds = 0  # in a row
        self.boot_us = 0
        self.arrival_us = 0

    @property
    def is_off_pace(self) -> bool:
        """Whether the clock keeps no time, by the host's: its seconds are none."""
        return self._off_seconds >= OFF_SECONDS

    def advance(self, raw_us: int, arrival_us: int) -> Unwrapped | None:
        """The unwrapped time of a message, or None while a large step is unconfirmed."""
        if not self._started:
            self._started = True
            self._restart(raw_us, arrival_us)
            return Unwrapped(raw_us, None)
        boot_us = self._unwrap(raw_us, arrival_us)
        reason = self._judge(boot_us - self.boot_us, arrival_us - self.arrival_us)
        self.is_beside = self._beside is not None and self._goes_on_beside(boot_us, arrival_us)
        if self.is_beside:
            self._beside, self._candidate = (boot_us, arrival_us), None
            return None
        if reason is None:
            self._drop_candidate()
            return Unwrapped(boot_us, self._accept(boot_us, arrival_us))
        candidate = self._candidate
        if candidate is None or not self._confirms(boot_us, arrival_us):
            self._candidate = (boot_us, arrival_us)
            return None
        reset = Reset(reason, candidate[0] - self.boot_us)
        self._beside = (self.boot_us, self.arrival_us)
        self._restart(*candidate)
        self._accept(boot_us, arrival_us)
        return Unwrapped(boot_us, reset, boot_us - candidate[0])

    def goes_on(self, raw_us: int, arrival_us: int) -> bool:
        """Take a message that just goes on in time; False, and nothing done, for any other.

        Nearly all messages do. It is what :meth:`advance` does with them, in less time.
        """
        boot_us = raw_us + self.wrapped_us
        if not (self._started and 0 < boot_us - self.boot_us <= ORDINARY_STEP_US):
            return False
        if self._off_seconds:
            return False
        if self._beside is not None and boot_us - self.boot_us > BESIDE_US:
            return False
        if self._candidate is not None:
            self._drop_candidate()
        self._accept(boot_us, arrival_us)
        return True

    def numbers(self) -> tuple[int, ...] | None:
        """What changes while messages just go on; None if something else is to be expected.

        In the columns of :mod:`drivers.samples.going_on`.
        """
        if not self._started or self._off_seconds or self._candidate is not None:
            return None
        now = (self.wrapped_us, self.boot_us, self.arrival_us, self._floor_us)
        return (1, *now, *self._second, *self._in_pace, int(self._beside is not None))

    def resume(self, numbers: list[int]) -> None:
        """Go on from :meth:`numbers`."""
        _, self.wrapped_us, self.boot_us, self.arrival_us, self._floor_us, *rest, _ = numbers
        self._second, self._in_pace = (rest[0], rest[1], rest[2]), (rest[3], rest[4])

    def _drop_candidate(self) -> None:
        """The line goes on: what stepped away from it was garbled, or is somebody else's."""
        if self._candidate is not None:
            self._beside, self._candidate = self._candidate, None

    def _goes_on_beside(self, boot_us: int, arrival_us: int) -> bool:
        """Whether a message goes on with another line that keeps this one's pace, not with this.

        A clock that began anew or leapt never comes back to where it was, while it goes on here.
        """
        here_us = arrival_us - self.arrival_us
        if self._beside is None or not 0 <= here_us < ALIVE_US:
            return False
        if abs(boot_us - self.boot_us - here_us) < BESIDE_US:
            return False
        step_us, elapsed_us = boot_us - self._beside[0], arrival_us - self._beside[1]
        return step_us > 0 and abs(step_us - elapsed_us) < BESIDE_US

    def _unwrap(self, raw_us: int, arrival_us: int) -> int:
        boot_us = raw_us + self.wrapped_us
        wrap_us = self._wrap_us
        if wrap_us is None or self.boot_us - boot_us < wrap_us // 2:
            return boot_us
        step_us = boot_us + wrap_us - self.boot_us
        last_raw_us = self.boot_us - self.wrapped_us
        is_wrap = last_raw_us < wrap_us and step_us >= -REORDERED_US
        if is_wrap and self._judge(step_us, arrival_us - self.arrival_us) is None:
            self.wrapped_us += wrap_us
            return boot_us + wrap_us
        return boot_us

    def _judge(self, step_us: int, elapsed_us: int) -> Literal["reboot", "jump"] | None:
        elapsed_us = max(elapsed_us, 0)
        if step_us < -REORDERED_US:
            return "reboot"
        lateness_us = min(self.arrival_us - self.boot_us - self._floor_us, LATENESS_LIMIT_US)
        if step_us - elapsed_us > JUMP_US + lateness_us:
            return "jump"
        if step_us > ORDINARY_STEP_US and elapsed_us - step_us > LOST_TIME_US:
            return "jump"
        return None

    def _confirms(self, boot_us: int, arrival_us: int) -> bool:
        assert self._candidate is not None
        step_us = boot_us - self._candidate[0]
        elapsed_us = max(arrival_us - self._candidate[1], 0)
        return 0 < step_us <= elapsed_us + JUMP_US

    def _accept(self, boot_us: int, arrival_us: int) -> Reset | None:
        """Go on to a message; the reset if the clock keeps time again since that."""
        if boot_us <= self.boot_us:
            return None
        elapsed_us = arrival_us - self.arrival_us
        offset_us = arrival_us - boot_us
        host_stepped = elapsed_us < 0 or elapsed_us - (boot_us - self.boot_us) > LOST_TIME_US
        risen_us = self._floor_us + int(CLOCK_DRIFT * elapsed_us)
        self._floor_us = offset_us if host_stepped else min(risen_us, offset_us)
        self.boot_us, self.arrival_us = boot_us, arrival_us
        if 0 <= arrival_us - self._second[1] < SECOND_US:
            return None
        return self._compare_pace()

    def _compare_pace(self) -> Reset | None:
        """Compare the second that ends with the host's; the reset if time is kept again.

        A longer time without a message is a gap, which says nothing of the pace.
        """
        begin_us, begin_arrival_us, late_us = self._second
        step_us, elapsed_us = self.boot_us - begin_us, self.arrival_us - begin_arrival_us
        lateness_us = max(self.arrival_us - self.boot_us - self._floor_us, 0)
        self._second = (self.boot_us, self.arrival_us, lateness_us)
        if not 0 < elapsed_us <= ORDINARY_STEP_US:
            return None
        is_slow = OFF_PACE * step_us < elapsed_us
        if is_slow or step_us - late_us > OFF_PACE * elapsed_us:
            self._off_seconds += 1
            return None
        lost_us = self.boot_us - self._in_pace[0] - (self.arrival_us - self._in_pace[1])
        reset = Reset("jump", lost_us) if self.is_off_pace else None
        self._off_seconds = 0
        self._in_pace = (self.boot_us, self.arrival_us)
        return reset

    def _restart(self, boot_us: int, arrival_us: int) -> None:
        self._candidate = None
        self._floor_us = arrival_us - boot_us
        self._second = (boot_us, arrival_us, 0)
        self._in_pace = (boot_us, arrival_us)
        self._off_seconds = 0
        self.boot_us, self.arrival_us = boot_us, arrival_us


class ClockOffset:
    """The constant distance of one clock from another, learnt as a running median."""

    def __init__(self) -> None:
        self._samples_us: deque[int] = deque(maxlen=OFFSET_SAMPLES)  # the oldest is dropped
        self._since_median = 0
        self._offset_us = 0

    def numbers(self) -> tuple[int, ...]:
        """What :meth:`learn` changes, in the columns of :mod:`drivers.samples.going_on`."""
        n, samples_us = len(self._samples_us), self._samples_us
        empty = (0,) * (OFFSET_SAMPLES - n)
        return (n, self._offset_us, self._since_median, 0, *samples_us, *empty)

    def resume(self, numbers: list[int]) -> None:
        """Go on from :meth:`numbers`, whose fourth is the place of the oldest sample."""
        n, self._offset_us, self._since_median, oldest, *ring_us = numbers
        samples_us = (*ring_us[oldest:n], *ring_us[:oldest])
        self._samples_us = deque(samples_us, OFFSET_SAMPLES)

    def learn(self, sample_us: int) -> int:
        """Take one estimate in; the offset in us, exactly 0 (or a whole wrap) for one clock."""
        self._samples_us.append(sample_us)
        self._since_median += 1
        if len(self._samples_us) < OFFSET_SAMPLES or self._since_median >= OFFSET_SAMPLES // 4:
            self._since_median = 0
            median_us = sorted(self._samples_us)[len(self._samples_us) // 2]
            whole_us = round(median_us / WRAP_32_US) * WRAP_32_US
            same_clock = abs(median_us - whole_us) < SAME_CLOCK_US
            self._offset_us = whole_us if same_clock else median_us
        return self._offset_us


class VehicleClock:
    """All clocks of one vehicle on one continuous line of time.

    The line is ``time_usec`` of the IMU messages, or ``time_boot_ms`` for a
    vehicle that sends nothing else. Times of the other clocks are moved onto
    it by their learnt offset; each restarts when it or the line is reset. What comes by a
    clock that is off pace is refused, and an IMU message of another clock makes the line then.
    """

    def __init__(self) -> None:
        self._lines = {field: ClockLine(field.value) for field in TimeField}
        self._offsets = {field: ClockOffset() for field in TimeField}
        self._primary: TimeField | None = None
        self._shift_us = 0  # continuous time - boot clock, on the primary line
        self._latest_us = 0  # the latest continuous time given
        self._streams: dict[tuple[TimeField, str], Placed] = {}
        self._waiting: set[TimeField] = set()  # began anew; the line of time may be about to
        self._forgotten: set[TimeField] = set()  # whose streams were, see take_forgotten

    def imu(self, message: str, field: TimeField, raw_us: int, arrival_us: int) -> Placed | Refused:
        """Place an IMU message; within one ``message`` the times given only ever grow."""
        if self._primary is None:
            self._primary = field
        elif field is not self._primary and self._takes_over(field):
            self._promote(field, raw_us, arrival_us)
        line = self._lines[field]
        if field is self._primary and line.goes_on(raw_us, arrival_us):
            return self._in_order(message, field, self._on_line(line.boot_us))
        return self._in_order(message, field, self._place(field, raw_us, arrival_us))

    def other(
        self, message: str, field: TimeField, raw_us: int, arrival_us: int
    ) -> Placed | Refused:
        """Place another message, once an IMU message has started the line of time."""
        if self._primary is None:
            return Refused(Reason.NO_CLOCK)
        return self._in_order(message, field, self._place(field, raw_us, arrival_us))

    def numbers(self) -> tuple[int, ...] | None:
        """What changes while messages just go on; None if something else is to be expected.

        In the columns of :mod:`drivers.samples.going_on`: the line of time, the clocks, and the
        offsets of those that the line need not be made of.
        """
        primary = self._primary
        if primary not in KEPT_LINES[:2] or self._waiting:
            return None
        lines = [self._lines[field].numbers() or (0,) * LINE_SIZE for field in KEPT_LINES]
        offsets = [self._offsets[field].numbers() for field in KEPT_OFFSETS]
        first = KEPT_LINES.index(primary)
        return (first, self._shift_us, self._latest_us, *chain(*lines, *offsets))

    def resume(self, numbers: list[int]) -> None:
        """Go on from :meth:`numbers`."""
        self._latest_us = numbers[2]
        for k, field in enumerate(KEPT_LINES):
            line = numbers[3 + k * LINE_SIZE : 3 + (k + 1) * LINE_SIZE]
            if line[0]:
                self._lines[field].resume(line)
        at = 3 + len(KEPT_LINES) * LINE_SIZE
        for field in KEPT_OFFSETS:
            self._offsets[field].resume(numbers[at : at + OFFSET_SIZE])
            at += OFFSET_SIZE

    def take_forgotten(self) -> set[TimeField]:
        """The clocks whose streams were forgotten since the last call, as they began anew."""
        forgotten, self._forgotten = self._forgotten, set()
        return forgotten

    def last_placed(self, message: str, field: TimeField) -> tuple[int, int] | None:
        """Continuous and boot time of the last message that was placed; None if none was."""
        last = self._streams.get((field, message))
        return None if last is None else (last.time_us, last.boot_us)

    def resume_after(self, message: str, field: TimeField, time_us: int, boot_us: int) -> None:
        """Go on with a message after one that was placed there."""
        self._streams[field, message] = Placed(time_us, boot_us, None)

    def _takes_over(self, field: TimeField) -> bool:
        """Whether an IMU message's clock is to make the line of time from now on."""
        assert self._primary is not None
        if self._lines[field].is_off_pace:
            return False
        return field is TimeField.TIME_USEC or self._lines[self._primary].is_off_pace

    def _promote(self, field: TimeField, raw_us: int, arrival_us: int) -> None:
        """Let another clock take the line over, without a break in time."""
        assert self._primary is not None
        old = self._lines[self._primary]
        elapsed_us = max(arrival_us - old.arrival_us, 0)
        now_us = max(old.boot_us + self._shift_us + elapsed_us, self._latest_us)
        self._primary = field
        self._shift_us = now_us - raw_us - self._lines[field].wrapped_us
        self._offsets = {field: ClockOffset() for field in TimeField}

    def _place(self, field: TimeField, raw_us: int, arrival_us: int) -> Placed | Refused:
        line = self._lines[field]
        reading = line.advance(raw_us, arrival_us)
        if reading is None:
            return Refused(Reason.ADDRESS_CONFLICT if line.is_beside else Reason.CLOCK_STEP)
        if line.is_off_pace:
            return Refused(Reason.CLOCK_PACE)
        if reading.reset is not None:
            self._forget(field)
        if field is self._primary:
            return self._on_line(reading.boot_us, reading.reset, reading.since_reset_us)
        if field in self._waiting:
            return Refused(Reason.NO_CLOCK)
        return self._beside_line(field, reading, arrival_us)

    def _on_line(self, boot_us: int, reset: Reset | None = None, since_reset_us: int = 0) -> Placed:
        if reset is not None:
            began_us = boot_us - since_reset_us
            self._shift_us = self._latest_us + CUT_STEP_US - began_us
            self._offsets = {field: ClockOffset() for field in TimeField}
        self._waiting.clear()
        time_us = boot_us + self._shift_us
        self._latest_us = max(self._latest_us, time_us)
        return Placed(time_us, boot_us, reset, since_reset_us)

    def _beside_line(self, field: TimeField, reading: Unwrapped, arrival_us: int) -> Placed:
        assert self._primary is not None
        line = self._lines[self._primary]
        line_now_us = line.boot_us + max(arrival_us - line.arrival_us, 0)
        offset_us = self._offsets[field].learn(reading.boot_us - line_now_us)
        time_us = reading.boot_us - offset_us + self._shift_us
        if field is not TimeField.GPS:
            self._latest_us = max(self._latest_us, time_us)
        return Placed(time_us, reading.boot_us, None)

    def _forget(self, field: TimeField) -> None:
        self._offsets[field] = ClockOffset()
        self._streams = {key: last for key, last in self._streams.items() if key[0] is not field}
        self._waiting.add(field)
        self._forgotten.add(field)

    def _in_order(
        self, message: str, field: TimeField, placed: Placed | Refused
    ) -> Placed | Refused:
        if isinstance(placed, Refused):
            return placed
        last = self._streams.get((field, message))
        if last is not None:
            if placed.boot_us == last.boot_us:
                return Refused(Reason.DUPLICATE)
            if placed.boot_us < last.boot_us:
                return Refused(Reason.OUT_OF_ORDER)
            if placed.time_us <= last.time_us:  # a learnt offset moved
                placed = msgspec.structs.replace(placed, time_us=last.time_us + 1)
        self._streams[field, message] = placed
        return placed
