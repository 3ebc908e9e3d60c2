"""Whether a clock keeps time, by the host's, and whether its messages arrive steadily."""

from dataclasses import dataclass

SECOND_US = 1_000_000
LONGEST_SECOND_US = 2 * SECOND_US  # a longer time without a message is a gap, not a pace
# Off pace is a clock that for two seconds in a row was so many times too fast or too slow. A burst
# makes up for the silence before it, so it is no pace. None of 46 recorded logs has such seconds.
OFF_PACE = 5
OFF_SECONDS = 2
# Arrivals are steady after so many seconds without a sample that was later than that.
STEADY_SECONDS = 5
STEADY_LATE_US = SECOND_US // 10


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
