"""When the attitudes of one vehicle are published: a grid of fixed period that meets its stream.

Attitude k is due at the start, plus k periods, plus an offset. The offset slides towards the
arrivals of the vehicle's samples, so that an attitude leaves as soon as its sample has been taken,
and always stays within half a period: the count over any time is that of the period, give or take
one. Times are the host's, in us.
"""

# How far the grid moves towards an arrival, as a share of what separates them.
SLIDE = 0.125


class PublishGrid:
    """The grid of one vehicle."""

    __slots__ = ("_begun", "_due_us", "_offset_us", "_period_us", "skipped")

    def __init__(self, rate_hz: float) -> None:
        self._period_us = 1e6 / rate_hz
        self._due_us = 0.0  # without the offset
        self._offset_us = 0.0
        self._begun = False
        self.skipped = 0  # attitudes that were due while nobody could publish them

    @property
    def due_us(self) -> float:
        """When the next attitude is due."""
        return self._due_us + self._offset_us

    def is_due(self, now_us: int) -> bool:
        """Whether the next attitude is due; at once if the host's clock was set back."""
        return not 0.0 < self.due_us - now_us <= 2.0 * self._period_us

    def meets(self, now_us: int, sample_period_us: float) -> bool:
        """Whether the sample taken at ``now_us`` is the one that the next attitude waits for."""
        if not self._begun or self.is_due(now_us):
            return True
        early_us = min(0.5 * sample_period_us, 0.5 * self._period_us)
        return self.due_us - now_us <= early_us

    def deadline_us(self, last_arrival_us: int, sample_period_us: float) -> float:
        """When the next attitude is published without a sample of its own.

        Where a sample is expected within half a period around the due time, it is waited for.
        """
        due_us, half_us = self.due_us, 0.5 * self._period_us
        expected_us = last_arrival_us + sample_period_us
        waits = sample_period_us > 0.0 and due_us - half_us < expected_us < due_us + half_us
        return due_us + half_us if waits else due_us

    def advance(self, now_us: int, *, has_sample: bool) -> None:
        """An attitude was published at ``now_us``, with a sample of its own or without."""
        late_us = now_us - self.due_us
        if not self._begun or abs(late_us) > 2e6:  # the first, or the clock was set
            self._begun = True
            self._due_us, self._offset_us = now_us + self._period_us, 0.0
            return
        if has_sample:
            self._slide(late_us)
        self._due_us += self._period_us
        missed = int((now_us - self.due_us) // self._period_us)
        if missed > 0:
            self.skipped += missed
            self._due_us += missed * self._period_us

    def _slide(self, late_us: float) -> None:
        half_us = 0.5 * self._period_us
        self._offset_us += SLIDE * max(-half_us, min(half_us, late_us))
        if self._offset_us > half_us:
            self._offset_us -= self._period_us
        elif self._offset_us <= -half_us:
            self._offset_us += self._period_us
