"""What was published of one vehicle, and when the next record is due. Times are the host's.

Each vehicle has a grid of fixed period that meets its stream: attitude k is due at the start, plus
k periods, plus an offset. The offset slides towards the arrivals of the vehicle's samples, so that
an attitude leaves as soon as its sample has been taken, and stays within half a period: the count
over any time is that of the period, give or take one.
"""

from service.load import Load
from service.records import Retuned

STATUS_PERIOD_US = 1_000_000
# While samples are left out, an attitude of an old sample is repeated no more often than this.
REPEATED_US = 250_000
GOLDEN = 0.6180339887498949  # its multiples spread evenly over the unit interval


class Publishing:
    """Counts of the records of one vehicle, and their schedule."""

    def __init__(self, rate_hz: float) -> None:
        self.grid = PublishGrid(rate_hz)
        self.attitudes = 0
        self.statuses = 0
        self.retuned: Retuned | None = None
        self.wake_us = 0.0  # when to look next, as far as was known at the last look
        self._samples = -1  # at the last attitude,
        self._attitude_us = 0  # and when that was
        self._status_us: int | None = None
        self._attitudes_then = 0  # at the last status
        self._status_due_us = 0
        self._status_period_us = STATUS_PERIOD_US
        self._second_status = 1.0  # a share of the period after the first

    def stagger(self, number: int) -> None:
        """Spread the statuses of vehicles over the second; this is the n-th that came."""
        self._second_status = 1.0 - number * GOLDEN % 1.0

    def note_attitude(self, now_us: int, samples: int) -> None:
        """An attitude was published, after so many samples."""
        self.grid.advance(now_us, has_sample=samples != self._samples)
        self.attitudes += 1
        self._samples, self._attitude_us = samples, now_us

    def is_stale(self, now_us: int, samples: int) -> bool:
        """Whether an attitude would say nothing new: its sample was published just before."""
        return samples == self._samples and 0 <= now_us - self._attitude_us < REPEATED_US

    def is_status_due(self, now_us: int) -> bool:
        """Whether it is time for a status; right away after the host's clock was set."""
        return not 0 < self._status_due_us - now_us <= 2 * self._status_period_us

    @property
    def status_due_us(self) -> int:
        """When the next status is due."""
        return self._status_due_us

    def note_status(self, now_us: int, period_us: int = STATUS_PERIOD_US) -> None:
        """A status was published; the next one is due a period after this one was."""
        self.statuses += 1
        self._status_period_us = period_us
        if self.statuses == 1:
            self._status_due_us = now_us + round(self._second_status * period_us)
            return
        due_us = self._status_due_us + period_us
        is_steady = 0 < due_us - now_us <= period_us
        self._status_due_us = due_us if is_steady else now_us + period_us

    def note_retuned(self, summary: str) -> None:
        """The service has changed the profile by itself."""
        count = 0 if self.retuned is None else self.retuned.count
        self.retuned = Retuned(count + 1, summary)

    def published_hz(self, now_us: int, load: Load) -> float:
        """Attitudes a second since the last status; the rate asked for where there is no need."""
        since_us = None if self._status_us is None else now_us - self._status_us
        count = self.attitudes - self._attitudes_then
        self._status_us, self._attitudes_then = now_us, self.attitudes
        if not load.is_shedding or since_us is None or since_us <= 0:
            return load.rate_hz
        return min(load.rate_hz, round(1e6 * count / since_us, 1))


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
        aliasing = int((now_us - self.due_us) // self._period_us)
        if aliasing > 0:
            self.skipped += aliasing
            self._due_us += aliasing * self._period_us

    def _slide(self, late_us: float) -> None:
        half_us = 0.5 * self._period_us
        self._offset_us += SLIDE * max(-half_us, min(half_us, late_us))
        if self._offset_us > half_us:
            self._offset_us -= self._period_us
        elif self._offset_us <= -half_us:
            self._offset_us += self._period_us
