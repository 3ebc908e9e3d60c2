"""Whether a clock keeps time: its seconds compared with the host's."""

from dataclasses import dataclass

from drivers.events import Value

SECOND_US = 1_000_000
LONGEST_SECOND_US = 2 * SECOND_US  # a longer time without a message is a gap, not a pace
# Off pace is a clock that for two seconds in a row was so many times too fast or too slow. A burst
# makes up for the silence before it, so it is no pace. None of 46 recorded logs has such seconds.
OFF_PACE, OFF_SECONDS = 5, 2
# Arrivals are steady after so many seconds without a sample that was later than that.
STEADY_SECONDS, STEADY_LATE_US = 5, SECOND_US // 10


class Moment(Value, frozen=True):
    """A message's time on its clock, unwrapped, and its arrival."""

    boot_us: int
    arrival_us: int

    def since(self, before: "Moment") -> tuple[int, int]:
        """How far the clock and the arrivals have gone on."""
        return self.boot_us - before.boot_us, self.arrival_us - before.arrival_us


START = Moment(0, 0)


@dataclass(slots=True)
class ClockPace:
    """Compares a clock's seconds with the host's."""

    has_arrivals: bool
    began: Moment = START  # this second
    kept: Moment = START  # the end of the last second that was in pace
    steady_seconds: int = 0
    off_seconds: int = 0
    late_us: int = 0  # at the second's beginning, and the largest within
    worst_late_us: int = 0

    @property
    def is_off(self) -> bool:
        """Whether the clock keeps no time."""
        return self.off_seconds >= OFF_SECONDS

    @property
    def is_steady(self) -> bool:
        """Whether messages have arrived without delay for some seconds."""
        is_long = self.has_arrivals and self.steady_seconds >= STEADY_SECONDS
        return is_long and self.worst_late_us <= STEADY_LATE_US

    def observe(self, now: Moment, late_us: int) -> int | None:
        """Take a message; the time that was lost (us), if the clock keeps time again."""
        self.worst_late_us = max(self.worst_late_us, late_us)
        step_us, elapsed_us = now.since(self.began)
        if 0 <= elapsed_us < SECOND_US:
            return None
        is_fast = step_us - self.late_us > OFF_PACE * elapsed_us
        is_steady = self.worst_late_us <= STEADY_LATE_US and 0 < elapsed_us <= LONGEST_SECOND_US
        self.steady_seconds = self.steady_seconds + 1 if is_steady else 0
        self.began, self.late_us, self.worst_late_us = now, max(late_us, 0), max(late_us, 0)
        if not 0 < elapsed_us <= LONGEST_SECOND_US:
            return None
        if is_fast or OFF_PACE * step_us < elapsed_us:
            self.off_seconds += 1
            return None
        (step_us, elapsed_us), was_off = now.since(self.kept), self.is_off
        self.kept, self.off_seconds = now, 0
        return step_us - elapsed_us if was_off else None
