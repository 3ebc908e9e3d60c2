"""The vehicle's own time, made continuous.

An autopilot stamps its messages with up to three clocks: ``time_usec`` of the
IMU messages, ``time_boot_ms`` of most others, and the time of GPS_RAW_INT.
They are usually one clock, but old firmware wraps the first at 2^32 us, some
run a constant 2.3 to 2.6 s apart, and the last may be Unix time. Clocks start
anew when the vehicle reboots, and leap when a recorder joins two sessions.

``VehicleClock`` puts all of that on one line of time: that of the IMU
messages, with reboots and jumps cut out. Nothing here reads the host's clock.
"""

from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum

from drivers.samples.clock_line import REORDERED_US, SECOND_US, ClockLine, Moment, Reset
from drivers.value import Value
from estimator.reasons import Reason

CUT_STEP_US = 20_000  # put in the place of what a reboot or a jump cut out
OFFSET_SAMPLES = 64  # enough for a median through 0.4 s of jitter
SAME_CLOCK_US = 1 * SECOND_US  # closer clocks are one clock; others were 2.3 s apart or more
WRAP_32_US = 2**32
# So many messages of a stream in a row, the first behind what came before but in order among
# themselves, are those of a clock that was set back.
SET_BACK_MESSAGES = 3
TICK_US = 1_000  # of the coarsest clock
MOST_US = 1 << 53  # 285 years: a time beyond is garbage, and counts as this


class TimeField(IntEnum):
    """Which of the vehicle's clocks a message carries."""

    TIME_USEC = 0
    BOOT_MS = 1
    GPS = 2


WRAPS_US = (WRAP_32_US, WRAP_32_US * 1000, 0)  # of these clocks; 0: it has none


class Placed(Value, frozen=True):
    """A message's place in time: continuous, and on the vehicle's own unwrapped clock."""

    time_us: int
    boot_us: int
    reset: Reset | None


@dataclass(slots=True)
class Stream:
    """Where one message was placed last, and what has fallen behind that since, in a row."""

    time_us: int
    boot_us: int
    arrival_us: int
    before_us: int  # boot time of the one before
    row: int = 0  # how many
    first: Moment | None = None  # of those, and the time of the latest
    latest_us: int = 0

    def goes_back(self, now: Moment) -> Moment | None:
        """The first of a row up to this message that a clock which was set back would make.

        It is behind what came before the last one, too: a late one need not be.
        """
        if self.row == 0 or now.boot_us <= self.latest_us:
            self.row, self.first = 0, now
        self.row += 1
        self.latest_us = now.boot_us
        first = self.first
        if self.row < SET_BACK_MESSAGES or first is None:
            return None
        span_us, heard_us = now.boot_us - first.boot_us, now.arrival_us - first.arrival_us
        is_steady = abs(heard_us - span_us) <= span_us // 4
        return first if is_steady and first.boot_us <= self.before_us + TICK_US else None


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


class VehicleClock:
    """All clocks of one vehicle on one continuous line of time.

    The line is ``time_usec`` of the IMU messages, or ``time_boot_ms`` for a
    vehicle that sends nothing else. Times of the other clocks are moved onto
    it by their learnt offset; each restarts when it or the line is reset. What comes by a
    clock that is off pace is refused, and an IMU message of another clock makes the line then.
    Without ``hears_arrivals`` the log's own times stand in for those of arrival. Clocks that do not
    ``count_from_boot`` are those of a computer, which is set and does not begin at zero.
    """

    def __init__(self, *, hears_arrivals: bool = True, count_from_boot: bool = True) -> None:
        self._lines = [ClockLine(wrap, hears_arrivals, count_from_boot) for wrap in WRAPS_US]
        self._offsets = [ClockOffset() for _ in TimeField]
        self._waiting: set[TimeField] = set()  # clocks reset while the line may be about to be
        self.misses_some = False  # messages that were lost right before the next one
        self.resets = 0  # of any of the clocks
        self._primary: TimeField | None = None  # the clock that the line of time is made of
        self._shift_us = 0  # continuous time less boot time on that
        self._latest_us = 0  # continuous time given
        self._streams: list[dict[str, Stream]] = [{} for _ in TimeField]

    def imu(self, message: str, field: TimeField, raw_us: int, arrival_us: int) -> Placed | Reason:
        """Place an IMU message; within one ``message`` the times given only ever grow."""
        raw_us, arrival_us = min(raw_us, MOST_US), min(arrival_us, MOST_US)
        if field is not self._primary:
            self._choose_line(field, raw_us, arrival_us)
        return self._place(message, field, raw_us, arrival_us, is_imu=True)

    def other(
        self, message: str, field: TimeField, raw_us: int, arrival_us: int
    ) -> Placed | Reason:
        """Place another message, once an IMU message has started the line of time."""
        if self._primary is None:
            return Reason.NO_CLOCK
        return self._place(message, field, min(raw_us, MOST_US), min(arrival_us, MOST_US))

    def _place(
        self, message: str, field: TimeField, raw_us: int, arrival_us: int, *, is_imu: bool = False
    ) -> Placed | Reason:
        line, stream = self._lines[field], self._streams[field].get(message)
        found: Reason | Reset | None = None
        if stream is not None and (stream.row or raw_us + line.wrapped_us < stream.boot_us):
            may_tell = is_imu or field is not self._primary
            found = self._set_back(line, stream, raw_us, arrival_us) if may_tell else None
        if found is None:
            found = line.advance(raw_us, arrival_us, self.misses_some)
        if isinstance(found, Reason):
            return found
        if line.pace.is_off:
            return Reason.CLOCK_PACE
        boot_us = line.read_us
        if found is not None:
            stream = None
            self._begin_anew(field, found, boot_us)
        time_us = self._time(field, boot_us, arrival_us)
        if time_us is None:
            return Reason.NO_CLOCK
        if stream is None:
            self._streams[field][message] = Stream(time_us, boot_us, arrival_us, boot_us)
            return Placed(time_us, boot_us, found)
        if boot_us <= stream.boot_us:
            return Reason.DUPLICATE if boot_us == stream.boot_us else Reason.OUT_OF_ORDER
        stream.before_us, stream.row = stream.boot_us, 0
        stream.boot_us, stream.arrival_us = boot_us, arrival_us
        stream.time_us = max(time_us, stream.time_us + 1)  # a learnt offset moved
        return Placed(stream.time_us, boot_us, None)

    @staticmethod
    def _set_back(line: ClockLine, stream: Stream, raw_us: int, arrival_us: int) -> Reset | None:
        """How the clock was set back, if a message of a stream shows that."""
        now, last = Moment(raw_us + line.wrapped_us, arrival_us), stream.boot_us
        if not stream.row and last - now.boot_us > REORDERED_US:
            return None
        first = stream.goes_back(now)
        return first and line.set_back(Moment(last, stream.arrival_us), first, now)

    def _begin_anew(self, field: TimeField, reset: Reset, boot_us: int) -> None:
        """A clock was reset, as a message shows: what was known of its messages counts no more."""
        self.resets += 1
        self._offsets[field] = ClockOffset()
        self._waiting.add(field)
        self._streams[field].clear()
        if field is self._primary:
            self._cut_out(reset, boot_us)

    def _time(self, field: TimeField, boot_us: int, arrival_us: int) -> int | None:
        """A message's place on the line of time; None while nobody can tell."""
        if field is self._primary:
            time_us = boot_us + self._shift_us
            self._waiting.clear()
            self._latest_us = max(self._latest_us, time_us)
            return time_us
        return None if field in self._waiting else self._time_beside(field, boot_us, arrival_us)

    def _choose_line(self, field: TimeField, raw_us: int, arrival_us: int) -> None:
        """Let the clock of an IMU message make the line of time, if it is to from now on.

        One that takes over does so without a break in time.
        """
        if self._primary is None:
            self._primary = field
            return
        new, old = self._lines[field], self._lines[self._primary]
        if new.pace.is_off or (field is not TimeField.TIME_USEC and not old.pace.is_off):
            return
        now_us = old.boot_us + self._shift_us + max(arrival_us - old.arrival_us, 0)
        self._primary = field
        self._shift_us = max(now_us, self._latest_us) - raw_us - new.wrapped_us
        self._offsets = [ClockOffset() for _ in TimeField]

    def _cut_out(self, reset: Reset, boot_us: int) -> None:
        """Let the line of time go on across a reset of its own clock, up to a message."""
        if reset.elapsed_us is not None:
            self._shift_us += max(reset.elapsed_us, 1) - reset.step_us
        else:
            self._shift_us = self._latest_us + CUT_STEP_US - (boot_us - reset.since_us)
        self._offsets = [ClockOffset() for _ in TimeField]

    def _time_beside(self, field: TimeField, boot_us: int, arrival_us: int) -> int:
        """The continuous time of a message of another clock."""
        line = self._lines[self._primary or 0]
        line_now_us = line.boot_us + max(arrival_us - line.arrival_us, 0)
        time_us = boot_us - self._offsets[field].learn(boot_us - line_now_us) + self._shift_us
        if field is not TimeField.GPS:
            self._latest_us = max(self._latest_us, time_us)
        return time_us
