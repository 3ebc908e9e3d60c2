"""The IMU message in use of one vehicle: which it is, how often it comes, what was left out."""

from collections import Counter, deque

from drivers.events import Imu, Shed
from estimator.types import ImuSample
from service import health, imu_choice
from service.imu_choice import ImuChoice

# Enough for a steady median, few enough to follow a stream whose rate was changed.
PERIODS_KEPT = 51
MEDIAN_EVERY = 8  # samples; a median of 51 changes little in that time


class ImuStream:
    """What is measured of the samples that the estimator takes. Periods and gaps are in us."""

    def __init__(self) -> None:
        self.choice = ImuChoice()
        self.samples = 0
        self.worst_gap_us = 0
        self.last: Imu | None = None  # as the vehicle sent it
        self.last_sample: ImuSample | None = None  # in the body's axes
        self._periods_us: deque[int] = deque(maxlen=PERIODS_KEPT)
        self._median_us: float | None = None
        self._shed = 0  # of the message in use
        self._shed_before: Counter[str] = Counter()  # of each message, until one is in use
        self._silent_since_us: int | None = None  # the last arrival before a reboot

    @property
    def message(self) -> str | None:
        """The IMU message in use."""
        return self.choice.message

    @property
    def shed(self) -> int:
        """Samples left out of the message in use; before there is one, the most of any."""
        return self._shed + max(self._shed_before.values(), default=0)

    @property
    def median_period_us(self) -> float:
        """Median interval of the message in use on the vehicle's clock; 0 if unknown."""
        if self._median_us is None:
            periods = sorted(self._periods_us)
            self._median_us = float(periods[len(periods) // 2]) if periods else 0.0
        return self._median_us

    @property
    def median_rate_hz(self) -> float:
        """Rate of the message in use while it came, 0 if unknown."""
        return 1e6 / self.median_period_us if self.median_period_us > 0.0 else 0.0

    def choose(self, event: Imu) -> tuple[bool, str | None]:
        """Whether a message is the one in use, and the message that it has just replaced, if any.

        A message that comes first replaces "".
        """
        before, period_us = self.choice.message, self.median_period_us
        late_us = health.late_after_us(period_us)
        self.choice = imu_choice.consider(
            self.choice, event.message, event.arrival_us, late_us, period_us
        )
        if self.choice.message != event.message:
            return False, None
        if before == event.message:
            return True, None
        self._periods_us.clear()
        self._median_us = None
        if before is None:
            self._shed += self._shed_before[event.message]
            self._shed_before.clear()
        return True, before or ""

    def note_taken(self, event: Imu, sample: ImuSample) -> None:
        """Measure interval and gap of a sample that the estimator took, by the vehicle's clock."""
        if self._silent_since_us is not None:
            self._note_gap(event.arrival_us - self._silent_since_us)
            self._silent_since_us = None
        last = self.last
        if last is not None:
            period_us = event.sample.time_us - last.sample.time_us
            self._note_gap(period_us)
            if event.message == last.message:
                periods_us = self._periods_us
                periods_us.append(period_us)
                if len(periods_us) < PERIODS_KEPT or self.samples % MEDIAN_EVERY == 0:
                    self._median_us = None
        self.last, self.last_sample = event, sample
        self.samples += 1

    def note_shed(self, event: Shed) -> None:
        """Count samples left out of the message in use, or of one that may become it."""
        if self.choice.message is None:
            self._shed_before[event.message] += event.samples
        elif self.choice.message == event.message:
            self._shed += event.samples

    def note_reboot(self, last_arrival_us: int | None) -> None:
        """The vehicle began anew: which message was doubted before says nothing now."""
        self.choice = imu_choice.trust_all(self.choice)
        self._silent_since_us = last_arrival_us

    def doubt(self) -> None:
        """The gyroscope of the message in use is contradicted: any other message is better."""
        self.choice = imu_choice.doubt(self.choice)

    def _note_gap(self, gap_us: int) -> None:
        self.worst_gap_us = max(self.worst_gap_us, gap_us)
