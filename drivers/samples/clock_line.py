"""One of a vehicle's clocks: where it goes on, wraps, leaps, begins anew or keeps no time.

Arrivals come in with the data. They show a gap from a leap of the clock.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from drivers.value import Value
from estimator.reasons import Reason

SECOND_US = 1_000_000
REORDERED_US = 1 * SECOND_US  # further back than links reorder: the clock was set back
JUMP_US = 5 * SECOND_US  # real gaps agree with arrivals within 4 s (p99 of late arrivals)
# While messages arrive steadily, and none is missing, as little as that is a leap of the clock.
# Where a fresher copy takes over some are missing, unless it is 256: so many are numbered.
LEAP_US, LONGEST_LEAP_US = SECOND_US // 2, 4 * SECOND_US
# Set back by less nobody has it. One that was set back may be set forwards again: half as much is a
# leap then.
LEAST_BACK_US = SECOND_US // 25
BOOT_US = 10 * SECOND_US  # an autopilot that starts sends its first messages by then
LATENESS_LIMIT_US = 30 * SECOND_US  # a sample may be held back this long; seen: 14 s
LOST_TIME_US = 60 * SECOND_US  # arrivals show that much more time passed: another session
ORDINARY_STEP_US = 2 * SECOND_US  # a step this short is the same session, whatever arrivals show
CLOCK_DRIFT = 0.005  # boot clocks ran up to 136 ms a minute slow
# Two vehicles with one address send in turns: their times are two lines, each of which goes on.
ALIVE_US = 1 * SECOND_US
BESIDE_US = SECOND_US // 2
LONGEST_SECOND_US = 2 * SECOND_US  # a longer time without a message is a gap, not a pace
# Off pace is a clock that for two seconds in a row was so many times too fast or too slow. A burst
# makes up for the silence before it, so it is no pace. None of 46 recorded logs has such seconds.
OFF_PACE = 5
OFF_SECONDS = 2
# Arrivals are steady after so many seconds without a sample that was later than that.
STEADY_SECONDS = 5
STEADY_LATE_US = SECOND_US // 10

ResetKind = Literal["reboot", "jump"]


class Moment(NamedTuple):
    """A message's time on the vehicle's unwrapped clock, and its arrival."""

    boot_us: int
    arrival_us: int


class Reset(Value, frozen=True):
    """A clock began anew or leapt; ``step_us`` is how far it moved, signed.

    It is known when another message confirms it; the first behind it came ``since_us`` before.
    ``elapsed_us`` is the time that passed meanwhile by the arrivals, so that the line of time goes
    on across it; None where they cannot tell.
    """

    reason: ResetKind
    step_us: int
    since_us: int = 0
    elapsed_us: int | None = None


@dataclass(slots=True)
class ClockPace:
    """Compares a clock's seconds with the host's."""

    boot_us: int = 0  # where this second began, how late, and the largest lateness within
    arrival_us: int = 0
    late_us: int = 0
    worst_late_us: int = 0
    kept_boot_us: int = 0  # the end of the last second that was in pace
    kept_arrival_us: int = 0
    off_seconds: int = 0
    steady_seconds: int = 0

    def begin(self, boot_us: int, arrival_us: int, *, keeps_record: bool = False) -> None:
        """Begin with a message; the record of steady seconds may be kept."""
        self.boot_us, self.arrival_us, self.late_us, self.worst_late_us = boot_us, arrival_us, 0, 0
        self.kept_boot_us, self.kept_arrival_us = boot_us, arrival_us
        self.off_seconds = 0
        if not keeps_record:
            self.steady_seconds = 0

    @property
    def is_off(self) -> bool:
        """Whether the clock keeps no time."""
        return self.off_seconds >= OFF_SECONDS

    @property
    def is_steady(self) -> bool:
        """Whether messages have arrived without delay for some seconds."""
        return self.steady_seconds >= STEADY_SECONDS and self.worst_late_us <= STEADY_LATE_US

    def observe(self, boot_us: int, arrival_us: int, late_us: int) -> int | None:
        """Take a message; the time that was lost (us), if the clock keeps time again."""
        self.worst_late_us = max(self.worst_late_us, late_us)
        elapsed_us = arrival_us - self.arrival_us
        if 0 <= elapsed_us < SECOND_US:
            return None
        step_us = boot_us - self.boot_us
        is_fast = step_us - self.late_us > OFF_PACE * elapsed_us
        is_steady = self.worst_late_us <= STEADY_LATE_US and elapsed_us <= LONGEST_SECOND_US
        self.steady_seconds = self.steady_seconds + 1 if is_steady and elapsed_us > 0 else 0
        late_us = max(late_us, 0)
        self.boot_us, self.arrival_us, self.late_us = boot_us, arrival_us, late_us
        self.worst_late_us = late_us
        if not 0 < elapsed_us <= LONGEST_SECOND_US:
            return None
        if is_fast or OFF_PACE * step_us < elapsed_us:
            self.off_seconds += 1
            return None
        lost_us = boot_us - self.kept_boot_us - (arrival_us - self.kept_arrival_us)
        was_off, self.off_seconds = self.is_off, 0
        self.kept_boot_us, self.kept_arrival_us = boot_us, arrival_us
        return lost_us if was_off else None


@dataclass(slots=True)
class ClockLine:
    """Follows one clock from message to message; ``wrap_us`` is 0 if it never wraps.

    One that ``counts_from_boot`` shows by a time near zero that the vehicle has begun anew.

    A step that no gap explains counts once the next message agrees with it, so a single garbled
    time changes nothing.
    """

    wrap_us: int
    hears_arrivals: bool
    counts_from_boot: bool = True
    wrapped_us: int = 0  # what wraps have added so far
    is_started: bool = False
    read_us: int = 0  # unwrapped time of the latest message, whatever became of it
    boot_us: int = 0  # of the last that went on
    arrival_us: int = 0
    floor_us: int = 0  # the smallest arrival minus boot time, with drift
    candidate: Moment | None = None  # a message that stepped away, to be confirmed
    beside: Moment | None = None  # the last message of another line
    leap_us: int = LEAP_US  # what is a leap where arrivals are steady
    pace: ClockPace = field(default_factory=ClockPace)

    def advance(self, raw_us: int, arrival_us: int, misses_some: bool) -> Reason | Reset | None:
        """Take the clock's next message, whose time is ``read_us`` then.

        Why it is refused, or how the clock was reset; None, nearly always, if it just goes on.
        ``misses_some``: others before it were lost, so that a step forwards may be their time,
        however steady the arrivals are.
        """
        self.read_us = boot_us = raw_us + self.wrapped_us
        if not self.is_started:
            self.is_started = True
            self._restart(Moment(raw_us, arrival_us))
            return None
        is_ordinary = 0 < boot_us - self.boot_us <= self.leap_us
        if is_ordinary and self.candidate is None and not self.pace.off_seconds:
            self._accept(boot_us, arrival_us)
            return None
        if misses_some:
            self.pace.steady_seconds = 0
        self.read_us = boot_us = self._unwrapped(raw_us, arrival_us)
        if self.beside is not None and self._goes_on_beside(self.beside, boot_us, arrival_us):
            self.beside, self.candidate = Moment(boot_us, arrival_us), None
            return Reason.ADDRESS_CONFLICT
        step_us, elapsed_us = boot_us - self.boot_us, arrival_us - self.arrival_us
        if self._is_step(step_us, elapsed_us):
            found = self._confirm(Moment(boot_us, arrival_us))
            if isinstance(found, Reset) or self._is_step(step_us, elapsed_us):
                return found
        if self.candidate is not None:  # it was garbled, or is somebody else's
            self.beside, self.candidate = self.candidate, None
        lost_us = self._accept(boot_us, arrival_us)
        return None if lost_us is None else Reset("jump", lost_us)

    def set_back(self, last: Moment, first: Moment, now: Moment) -> Reset | None:
        """How the clock was reset, where messages from ``first`` to ``now`` came behind ``last``.

        None where they may just be late.
        """
        back_us = first.arrival_us - last.arrival_us - (first.boot_us - last.boot_us)
        is_young = self.counts_from_boot and first.boot_us - self.wrapped_us <= BOOT_US
        is_sure = is_young or not self.hears_arrivals or self.pace.is_steady
        if back_us < LEAST_BACK_US or not is_sure:
            return None
        self.boot_us, self.arrival_us = last
        self.read_us, self.leap_us = now.boot_us, min(self.leap_us, back_us // 2)
        return self._reset(first, now)

    def _confirm(self, new: Moment) -> Reason | Reset:
        """A message that stepped away: it waits for the next one, or confirms the last."""
        began = self.candidate
        if began is not None:
            since_us, most_us = new.boot_us - began.boot_us, JUMP_US
            if self._is_steady():
                most_us = LEAP_US
            if 0 <= since_us <= max(new.arrival_us - began.arrival_us, 0) + most_us:
                # another message of the same moment confirms nothing
                return self._reset(began, new) if since_us else Reason.CLOCK_STEP
            self.pace.steady_seconds = 0  # it may be the clock that is not
        self.candidate = new
        return Reason.CLOCK_STEP

    def _reset(self, began: Moment, new: Moment) -> Reset:
        step_us = began.boot_us - self.boot_us
        elapsed_us = max(began.arrival_us - self.arrival_us, 0)
        is_near_zero = 0 <= began.boot_us - self.wrapped_us <= elapsed_us + BOOT_US
        is_back = step_us < (-REORDERED_US if self._is_steady() else 0)
        is_boot = self.counts_from_boot and is_back and is_near_zero
        goes_on = not is_boot and self._is_steady() and abs(step_us - elapsed_us) < LONGEST_LEAP_US
        if not goes_on:
            self.beside = Moment(self.boot_us, self.arrival_us)
        self._restart(began, keeps_pace=goes_on)
        self._accept(*new)
        since_us = new.boot_us - began.boot_us
        reason: ResetKind = "reboot" if is_boot else "jump"
        return Reset(reason, step_us, since_us, elapsed_us if goes_on else None)

    def _restart(self, first: Moment, *, keeps_pace: bool = False) -> None:
        self.candidate = None
        self.boot_us, self.arrival_us = first
        self.floor_us = self.arrival_us - self.boot_us
        self.pace.begin(self.boot_us, self.arrival_us, keeps_record=keeps_pace)

    def _unwrapped(self, raw_us: int, arrival_us: int) -> int:
        boot_us = raw_us + self.wrapped_us
        if self.wrap_us == 0 or self.boot_us - boot_us < self.wrap_us // 2:
            return boot_us
        step_us = boot_us + self.wrap_us - self.boot_us
        may_wrap = self.boot_us - self.wrapped_us < self.wrap_us
        if may_wrap and not self._is_step(step_us, arrival_us - self.arrival_us):
            self.wrapped_us += self.wrap_us
            boot_us += self.wrap_us
        return boot_us

    def _is_step(self, step_us: int, elapsed_us: int) -> bool:
        """Whether a step of the clock is none that messages and gaps make."""
        if 0 <= step_us <= self.leap_us:
            return False
        if step_us < -REORDERED_US:
            return True
        ahead_us = step_us - max(elapsed_us, 0)
        late_us = self.arrival_us - self.boot_us - self.floor_us
        if ahead_us > JUMP_US + min(late_us, LATENESS_LIMIT_US):
            return True
        if self.leap_us + late_us < ahead_us < LONGEST_LEAP_US and self._is_steady():
            return True
        return step_us > ORDINARY_STEP_US and -ahead_us > LOST_TIME_US

    def _is_steady(self) -> bool:
        return self.hears_arrivals and self.pace.is_steady

    def _goes_on_beside(self, beside: Moment, boot_us: int, arrival_us: int) -> bool:
        """Whether a message goes on with another line that keeps this one's pace, not with this."""
        step_us, elapsed_us = boot_us - beside.boot_us, arrival_us - beside.arrival_us
        if step_us <= 0 or abs(step_us - elapsed_us) >= BESIDE_US:
            return False
        step_us, elapsed_us = boot_us - self.boot_us, arrival_us - self.arrival_us
        is_near = 0 < step_us <= BESIDE_US or abs(step_us - elapsed_us) < BESIDE_US
        return 0 <= elapsed_us < ALIVE_US and not is_near

    def _accept(self, boot_us: int, arrival_us: int) -> int | None:
        """Go on to a message; the time that was lost, if the clock keeps time again since that."""
        step_us, elapsed_us = boot_us - self.boot_us, arrival_us - self.arrival_us
        if step_us <= 0:
            return None
        offset_us = arrival_us - boot_us
        if elapsed_us < 0 or elapsed_us - step_us > LOST_TIME_US:
            self.floor_us = offset_us  # the host's clock was set
        else:
            floor_us = self.floor_us + int(CLOCK_DRIFT * elapsed_us)
            self.floor_us = min(offset_us, floor_us)
        self.boot_us, self.arrival_us = boot_us, arrival_us
        return self.pace.observe(boot_us, arrival_us, offset_us - self.floor_us)
