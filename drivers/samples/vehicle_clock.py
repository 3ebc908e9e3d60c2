"""The vehicle's own time, made continuous.

An autopilot stamps its messages with up to three clocks: ``time_usec`` of the IMU messages,
``time_boot_ms`` of most others, and the time of GPS_RAW_INT. They are usually one clock, but old
firmware wraps the first at 2^32 us, some run a constant 2.3 to 2.6 s apart, and the last may be
Unix time. Clocks start anew at a reboot, are set, and leap where a recorder joins two sessions.

Nothing here reads the host's clock. Arrivals come in with the data, and show a gap from a leap.
"""

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

from drivers.events import Value
from drivers.samples.clock_pace import SECOND_US, START, ClockPace, Moment
from estimator.reasons import Reason

REORDERED_US = 1 * SECOND_US  # further back than links reorder: the clock was set back
JUMP_US = 5 * SECOND_US  # real gaps agree with arrivals within 4 s (p99 of late arrivals)
# While messages arrive steadily, and none is missing, as little as that is a leap of the clock.
# Where a fresher copy takes over some are missing, unless it is 256: so many are numbered.
LEAP_US, LONGEST_LEAP_US = SECOND_US // 2, 4 * SECOND_US
# Nobody sets a clock back by less. Set back by more, it may be set forwards by half as much.
LEAST_BACK_US = SECOND_US // 25
# So many of a stream in a row, behind what came before but in order, show a clock that was set back
SET_BACK_MESSAGES = 3
# Two messages confirm a leap, but so many of one stream if the clock has gone on for so long, with
# a message right before, and time does not go on: it may come back to where it was.
SURE_MESSAGES, LASTING_US = 6, 5 * SECOND_US
TICK_US = 1_000  # of the coarsest clock
BOOT_US = 10 * SECOND_US  # an autopilot that starts sends its first messages by then
LATENESS_LIMIT_US = 30 * SECOND_US  # a sample may be held back this long; seen: 14 s
LOST_TIME_US = 60 * SECOND_US  # arrivals show that much more time passed: another session
ORDINARY_STEP_US = 2 * SECOND_US  # a step this short is the same session, whatever arrivals show
CLOCK_DRIFT = 0.005  # boot clocks ran up to 136 ms a minute slow
# Two vehicles with one address send in turns: their times are two lines, each of which goes on.
ALIVE_US, BESIDE_US = 1 * SECOND_US, SECOND_US // 2
CUT_STEP_US = 20_000  # put in the place of what a reboot or a jump cut out
OFFSET_SAMPLES = 64  # enough for a median through 0.4 s of jitter
SAME_CLOCK_US = 1 * SECOND_US  # closer clocks are one clock; others were 2.3 s apart or more
WRAP_32_US = 2**32
MOST_US = 1 << 53  # 285 years: a time beyond is garbage, and counts as this


class TimeField(IntEnum):
    """Which of the vehicle's clocks a message carries."""

    TIME_USEC = 0
    BOOT_MS = 1
    GPS = 2


WRAPS_US = (WRAP_32_US, WRAP_32_US * 1000, 0)  # of these clocks; 0: it has none


class Reset(Value, frozen=True):
    """A clock began anew or leapt; ``step_us`` is how far it moved, signed.

    It is known when another message confirms it; the first behind it came ``since_us`` before.
    ``elapsed_us`` is the time that passed meanwhile by the arrivals, so that the line of time goes
    on across it; None where they cannot tell.
    """

    reason: Literal["reboot", "jump"]
    step_us: int
    since_us: int = 0
    elapsed_us: int | None = None


class Placed(Value, frozen=True):
    """A message's place in time: continuous, and on the vehicle's own unwrapped clock."""

    time_us: int
    boot_us: int
    reset: Reset | None


@dataclass(slots=True)
class Stream:
    """Where one message was placed last, and those that have fallen behind it since, in a row."""

    time_us: int
    last: Moment
    before_us: int  # boot time of the one before
    row: list[Moment] = field(default_factory=list)


@dataclass(slots=True)
class ClockOffset:
    """A clock's constant distance from the line of time: the median of the latest estimates.

    It is exactly 0 (or a whole wrap) if both are one clock.
    """

    us: int = 0
    estimates_us: deque[int] = field(default_factory=lambda: deque(maxlen=OFFSET_SAMPLES))
    since_median: int = 0

    def learn(self, estimate_us: int) -> int:
        """The distance, with one more estimate in the median."""
        estimates = self.estimates_us
        estimates.append(estimate_us)
        self.since_median += 1
        if len(estimates) < OFFSET_SAMPLES or self.since_median >= OFFSET_SAMPLES // 4:
            self.since_median = 0
            median_us = sorted(estimates)[len(estimates) // 2]
            whole_us = round(median_us / WRAP_32_US) * WRAP_32_US
            self.us = whole_us if abs(median_us - whole_us) < SAME_CLOCK_US else median_us
        return self.us


@dataclass(slots=True)
class ClockLine:
    """Follows one clock from message to message; ``wrap_us`` is 0 if it never wraps.

    One that ``counts_from_boot`` shows by a time near zero that the vehicle has begun anew. A step
    that no gap explains counts once the next message agrees with it, so a single garbled time
    changes nothing. A step back that links make, too, takes a row of messages.
    """

    wrap_us: int
    counts_from_boot: bool
    pace: ClockPace
    streams: dict[str, Stream] = field(default_factory=dict)
    offset: ClockOffset = field(default_factory=ClockOffset)
    wrapped_us: int = 0  # what wraps have added so far
    read: Moment = START  # the latest message, whatever became of it
    first: Moment = START  # since it began, or began anew
    last: Moment | None = None  # that went on
    floor_us: int = 0  # the smallest arrival minus boot time, with drift
    candidate: Moment | None = None  # a message that stepped away, to be confirmed
    confirming: Counter[str] = field(default_factory=Counter)  # messages of each stream that do
    beside: Moment | None = None  # the last message of another line
    leap_us: int = LEAP_US  # what is a leap where arrivals are steady

    def advance(self, now: Moment, message: str, misses_some: bool) -> Reason | Reset | None:
        """Take the clock's next message, which is ``read`` then: why it is refused, or a reset.

        None, nearly always, if the clock just goes on. The stream of the ``message`` may show that
        it was set back, unless it has no name. If it ``misses_some`` that were lost, a step
        forwards may be their time.
        """
        self.read, last = now, self.last
        if last is None:
            self._restart(now)
            return None
        stream = self.streams.get(message)
        if stream is not None and (reset := self._set_back(stream, now)) is not None:
            return reset
        is_ordinary = 0 < now.boot_us - last.boot_us <= self.leap_us
        if is_ordinary and self.candidate is None and not self.pace.off_seconds:
            self._accept(now, last)
            return None
        if misses_some:
            self.pace.steady_seconds = 0
        self.read = now = self._unwrapped(now, last)
        if self.beside is not None and self._goes_on_beside(self.beside, now, last):
            self.beside, self.candidate = now, None
            return Reason.ADDRESS_CONFLICT
        if self._is_step(now, last):
            found = self._confirm(now, last, message)
            if isinstance(found, Reset) or self._is_step(now, last):
                return found
        if self.candidate is not None:  # it was garbled, or is somebody else's
            self.beside, self.candidate = self.candidate, None
        lost_us = self._accept(now, last)
        return None if lost_us is None else Reset("jump", lost_us)

    def _set_back(self, stream: Stream, now: Moment) -> Reset | None:
        """How the clock was reset, if a row of one stream's messages up to this one shows it.

        Its first is behind what came before the last one, too: a late one need not be. Further
        back than links reorder, one message begins no row: the next may confirm it.
        """
        last, row = stream.last, stream.row
        if not row and not 0 < last.boot_us - now.boot_us <= REORDERED_US:
            return None
        if row and now.boot_us <= row[-1].boot_us:
            row.clear()
        row.append(now)
        first = row[0]
        (span_us, elapsed_us), (step_us, passed_us) = now.since(first), first.since(last)
        is_row = len(row) >= SET_BACK_MESSAGES and abs(elapsed_us - span_us) <= span_us // 4
        back_us = passed_us - step_us
        is_late = first.boot_us > stream.before_us + TICK_US or back_us < LEAST_BACK_US
        is_young = self.counts_from_boot and first.boot_us - self.wrapped_us <= BOOT_US
        is_sure = is_young or not self.pace.has_arrivals or self.pace.is_steady
        if not is_row or is_late or not is_sure:
            return None
        self.leap_us = min(self.leap_us, back_us // 2)
        return self._begin_anew(self._reset_at(first, last, now), first, last, now)

    def _confirm(self, now: Moment, last: Moment, message: str) -> Reason | Reset:
        """A message that stepped away: it waits for the next ones, or confirms the first."""
        most_us = LEAP_US if self.pace.is_steady else JUMP_US
        began = self.candidate or now
        since_us, elapsed_us = now.since(began)
        if self.candidate is None or not 0 <= since_us <= max(elapsed_us, 0) + most_us:
            if self.candidate is not None:
                self.pace.steady_seconds = 0  # it may be the clock that is not
            self.candidate = began = now
            self.confirming = Counter()
        self.confirming[message] += 1
        reset = self._reset_at(began, last, now)
        is_known = reset.reason == "reboot" or reset.elapsed_us is not None
        was_silent = began.arrival_us - last.arrival_us >= ALIVE_US
        is_short = last.boot_us - self.first.boot_us < LASTING_US
        is_sure = bool(message) and self.confirming[message] >= SURE_MESSAGES
        # another message of the same moment confirms nothing
        if now.boot_us == began.boot_us or not (is_known or was_silent or is_short or is_sure):
            return Reason.CLOCK_STEP
        return self._begin_anew(reset, began, last, now)

    def _reset_at(self, began: Moment, last: Moment, now: Moment) -> Reset:
        """What it means if the clock has stepped from ``last`` to ``began``."""
        step_us, elapsed_us = began.since(last)
        elapsed_us = max(elapsed_us, 0)
        is_near_zero = 0 <= began.boot_us - self.wrapped_us <= elapsed_us + BOOT_US
        is_steady = self.pace.is_steady
        is_back = step_us < (-REORDERED_US if is_steady else 0)
        is_boot = self.counts_from_boot and is_back and is_near_zero
        goes_on = not is_boot and is_steady and abs(step_us - elapsed_us) < LONGEST_LEAP_US
        reason: Literal["reboot", "jump"] = "reboot" if is_boot else "jump"
        since_us, passed_us = now.boot_us - began.boot_us, elapsed_us if goes_on else None
        return Reset(reason, step_us, since_us, passed_us)

    def _begin_anew(self, reset: Reset, began: Moment, last: Moment, now: Moment) -> Reset:
        goes_on, is_steady = reset.elapsed_us is not None, self.pace.is_steady
        self.beside = self.beside if goes_on or is_steady else last
        self._restart(began, self.pace.steady_seconds if goes_on else 0)
        self._accept(now, began)
        return reset

    def _restart(self, first: Moment, steady_seconds: int = 0) -> None:
        self.first, self.last, self.candidate = first, first, None
        self.floor_us = first.arrival_us - first.boot_us
        self.pace = ClockPace(self.pace.has_arrivals, first, first, steady_seconds)

    def _unwrapped(self, now: Moment, last: Moment) -> Moment:
        if self.wrap_us == 0 or last.boot_us - now.boot_us < self.wrap_us // 2:
            return now
        wrapped = Moment(now.boot_us + self.wrap_us, now.arrival_us)
        if last.boot_us - self.wrapped_us >= self.wrap_us or self._is_step(wrapped, last):
            return now
        self.wrapped_us += self.wrap_us
        return wrapped

    def _is_step(self, now: Moment, last: Moment) -> bool:
        """Whether a step of the clock is none that messages and gaps make."""
        step_us, elapsed_us = now.since(last)
        if 0 <= step_us <= self.leap_us:
            return False
        if step_us < -REORDERED_US:
            return True
        ahead_us = step_us - max(elapsed_us, 0)
        late_us = last.arrival_us - last.boot_us - self.floor_us
        if ahead_us > JUMP_US + min(late_us, LATENESS_LIMIT_US):
            return True
        if self.leap_us + late_us < ahead_us < LONGEST_LEAP_US and self.pace.is_steady:
            return True
        return step_us > ORDINARY_STEP_US and -ahead_us > LOST_TIME_US

    @staticmethod
    def _goes_on_beside(beside: Moment, now: Moment, last: Moment) -> bool:
        """Whether a message goes on with another line that keeps this one's pace, not with this."""
        step_us, elapsed_us = now.since(beside)
        if step_us <= 0 or abs(step_us - elapsed_us) >= BESIDE_US:
            return False
        step_us, elapsed_us = now.since(last)
        is_near = 0 < step_us <= BESIDE_US or abs(step_us - elapsed_us) < BESIDE_US
        return 0 <= elapsed_us < ALIVE_US and not is_near

    def _accept(self, now: Moment, last: Moment) -> int | None:
        """Go on to a message; the time that was lost, if the clock keeps time again since that."""
        step_us, elapsed_us = now.since(last)
        if step_us <= 0:
            return None
        offset_us = now.arrival_us - now.boot_us
        self.floor_us = min(offset_us, self.floor_us + int(CLOCK_DRIFT * elapsed_us))
        if elapsed_us < 0 or elapsed_us - step_us > LOST_TIME_US:
            self.floor_us = offset_us  # the host's clock was set
        self.last = now
        return self.pace.observe(now, offset_us - self.floor_us)


class VehicleClock:
    """All clocks of one vehicle on one continuous line of time, reboots and jumps cut out.

    The line is ``time_usec`` of the IMU messages, or ``time_boot_ms`` for a vehicle that sends
    nothing else, or while the first is off pace and refused. Times of other clocks are moved onto
    it by their learnt offset; each restarts when it or the line is reset. Without ``has_arrivals``
    the log's own times stand in for those of arrival. Clocks that do not ``count_from_boot`` are
    those of a computer, which is set and does not begin at zero.
    """

    def __init__(self, *, has_arrivals: bool = True, count_from_boot: bool = True) -> None:
        self._lines = [
            ClockLine(wrap_us, count_from_boot, ClockPace(has_arrivals)) for wrap_us in WRAPS_US
        ]
        self._primary: ClockLine | None = None  # the clock that the line of time is made of
        self._shift_us = 0  # continuous time less boot time on that
        self._latest_us = 0  # continuous time given
        self._waiting = set[TimeField]()  # were reset, and the line of time may be about to be
        self.misses_some = False  # messages that were lost right before the next one
        self.resets = 0  # of any of the clocks

    def place(
        self, message: str, field: TimeField, raw_us: int, arrival_us: int, *, is_imu: bool = False
    ) -> Placed | Reason:
        """Place a message, once an IMU message has started the line of time.

        Within one ``message`` the times given only ever grow.
        """
        line = self._lines[field]
        now = Moment(min(raw_us, MOST_US) + line.wrapped_us, min(arrival_us, MOST_US))
        if is_imu and line is not self._primary:
            self._choose_line(line, now)
        if self._primary is None:
            return Reason.NO_CLOCK
        stream = line.streams.get(message)
        # samples show best whether the line's own clock was set back
        may_show = is_imu or line is not self._primary
        reset = line.advance(now, message if may_show else "", self.misses_some)
        if isinstance(reset, Reason):
            return reset
        if line.pace.is_off:
            return Reason.CLOCK_PACE
        now = line.read
        if reset is not None:
            stream = None
            self._begin_anew(line, reset, now)
            self._waiting.add(field)
        time_us = self._time(line, field, now)
        if time_us is None:
            return Reason.NO_CLOCK
        if stream is None:
            line.streams[message] = Stream(time_us, now, now.boot_us)
            return Placed(time_us, now.boot_us, reset)
        last_us = stream.last.boot_us
        if now.boot_us <= last_us:
            return Reason.DUPLICATE if now.boot_us == last_us else Reason.OUT_OF_ORDER
        stream.before_us, stream.last = last_us, now
        stream.row.clear()
        stream.time_us = max(time_us, stream.time_us + 1)  # a learnt offset moved
        return Placed(stream.time_us, now.boot_us, None)

    def _choose_line(self, new: ClockLine, now: Moment) -> None:
        """Let the clock of an IMU message make the line of time if it is to, without a break."""
        old = self._primary
        if old is None:
            self._primary = new
        elif not new.pace.is_off and (new is self._lines[TimeField.TIME_USEC] or old.pace.is_off):
            now_us = max(self._now_us(old, now.arrival_us), self._latest_us)
            self._primary, self._shift_us = new, now_us - now.boot_us
            self._forget_offsets()

    def _begin_anew(self, line: ClockLine, reset: Reset, now: Moment) -> None:
        """A clock was reset; if it makes the line of time, that goes on across the reset."""
        self.resets += 1
        line.offset = ClockOffset()
        line.streams.clear()
        if line is not self._primary:
            return
        if reset.elapsed_us is not None:
            self._shift_us += max(reset.elapsed_us, 1) - reset.step_us
        else:
            self._shift_us = self._latest_us + CUT_STEP_US - (now.boot_us - reset.since_us)
        self._forget_offsets()

    def _forget_offsets(self) -> None:
        for line in self._lines:
            line.offset = ClockOffset()

    def _now_us(self, line: ClockLine, arrival_us: int) -> int:
        """The continuous time at an arrival, by the last message of the clock that makes it."""
        last = line.last or START
        return last.boot_us + self._shift_us + max(arrival_us - last.arrival_us, 0)

    def _time(self, line: ClockLine, field: TimeField, now: Moment) -> int | None:
        """A message's place on the line of time; None while nobody can tell."""
        if line is self._primary or self._primary is None:
            time_us = now.boot_us + self._shift_us
            self._waiting.clear()
        elif field in self._waiting:
            return None
        else:
            ahead_us = now.boot_us - (self._now_us(self._primary, now.arrival_us) - self._shift_us)
            time_us = now.boot_us - line.offset.learn(ahead_us) + self._shift_us
            if field is TimeField.GPS:
                return time_us
        self._latest_us = max(self._latest_us, time_us)
        return time_us
