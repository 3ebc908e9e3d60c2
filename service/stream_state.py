"""Which of a vehicle's messages feed the estimator, how often its IMU comes, and since when not.

Messages of one vehicle may come from different IMUs, mounted and calibrated differently, so they
are never mixed: one is chosen. Another IMU is a last resort. On a lossy link one message may be
missing for seconds while another's come through, so the chosen one must have been silent for long
while the other came; and it must be back for as long before it is used again. One whose gyroscope
the estimator contradicts comes behind all others from then on.

Of messages that report the same, the best one is used as long as it comes: a change would look like
a change of what they report. Velocity has two sources, the autopilot's filter and a receiver; the
estimator models the errors of each, and takes one message of each.
"""

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median_high

from drivers.events import Imu, Report, Shed
from drivers.mavlink.messages import imu_rank
from drivers.samples.navigation import report_rank
from estimator.types import ImuSample, VelocitySample
from service.records import State

# Enough for a steady median, few enough to follow a stream whose rate was changed.
PERIODS_KEPT = 51
MEDIAN_EVERY = 8  # samples; a median of 51 changes little in that time
LATE_MINIMUM_US, LATE_PERIODS = 500_000, 3
LOST_MINIMUM_US, LOST_PERIODS = 5_000_000, 10
# The ages of two messages stamped by one clock differ by less than this.
OTHER_CLOCK_US = 1_000_000
SILENCE_US = 2_000_000  # of a report in use


class ImuStream:
    """What is measured of the samples that the estimator takes. Periods and gaps are in us."""

    def __init__(self) -> None:
        self.choice = ImuChoice()
        self.state = State.WAITING
        self.samples = 0
        self.worst_gap_us = 0
        self.last: Imu | None = None  # as the vehicle sent it
        self.last_sample: ImuSample | None = None  # in the body's axes
        self.last_arrival_us: int | None = None  # of any sample so far
        self._periods_us: deque[int] = deque(maxlen=PERIODS_KEPT)
        self.median_period_us = 0.0  # of the message in use by the vehicle's clock; 0 if unknown
        self._shed: Counter[str] = Counter()  # by message, of any until one is in use
        self._silent_since_us: int | None = None  # the last arrival before a reboot
        # of reports by type, and whether a receiver's: the message in use, and its last arrival
        self._reports: dict[tuple[type, bool], tuple[str, int]] = {}

    @property
    def message(self) -> str | None:
        """The IMU message in use."""
        return self.choice.message

    @property
    def shed(self) -> int:
        """Samples left out of the message in use; before there is one, the most of any."""
        counts = self._shed
        return max(counts.values(), default=0) if self.message is None else counts.total()

    @property
    def median_rate_hz(self) -> float:
        """Rate of the message in use while it came, 0 if unknown."""
        return 1e6 / self.median_period_us if self.median_period_us > 0.0 else 0.0

    @property
    def late_after_us(self) -> float:
        """Silence that makes a running estimate degraded: max(0.5 s, 3 median periods)."""
        return max(LATE_MINIMUM_US, LATE_PERIODS * self.median_period_us)

    @property
    def lost_after_us(self) -> float:
        """Silence after which a vehicle is lost: max(5 s, 10 median periods)."""
        return max(LOST_MINIMUM_US, LOST_PERIODS * self.median_period_us)

    def silence_us(self, now_us: int) -> int:
        """How long no sample has arrived."""
        return 0 if self.last_arrival_us is None else max(0, now_us - self.last_arrival_us)

    def state_at(self, now_us: int) -> State:
        """The state after the silence so far; only samples improve it."""
        silence_us = self.silence_us(now_us)
        if silence_us >= self.lost_after_us:
            return State.LOST
        is_late = self.state is State.RUNNING and silence_us >= self.late_after_us
        return State.DEGRADED if is_late else self.state

    def choose(self, event: Imu) -> bool:
        """Whether a message is the one in use from now on."""
        before = self.message
        is_chosen = self.choice.consider(event.message, event.arrival_us, self.median_period_us)
        if is_chosen and before != event.message:
            self._periods_us.clear()
            self.median_period_us = 0.0
            if before is None:
                self._shed = Counter({event.message: self._shed[event.message]})
        return is_chosen

    def note_taken(self, event: Imu, sample: ImuSample) -> None:
        """Measure interval and gap of a sample that the estimator took, by the vehicle's clock."""
        if self._silent_since_us is not None:
            silence_us = event.arrival_us - self._silent_since_us
            self.worst_gap_us = max(self.worst_gap_us, silence_us)
            self._silent_since_us = None
        if self.last is not None:
            period_us = sample.time_us - self.last.sample.time_us
            self.worst_gap_us = max(self.worst_gap_us, period_us)
            if event.message == self.last.message:
                self._periods_us.append(period_us)
                if len(self._periods_us) < PERIODS_KEPT or self.samples % MEDIAN_EVERY == 0:
                    self.median_period_us = float(median_high(self._periods_us))
        self.last, self.last_sample = event, sample
        self.samples += 1

    def note_shed(self, event: Shed) -> None:
        """Count samples left out of the message in use, or of one that may become it."""
        if self.message in (None, event.message):
            self._shed[event.message] += event.samples

    def note_reboot(self) -> None:
        """The vehicle began anew, which may have mended what was contradicted before."""
        self.choice.contradicted.clear()
        self._silent_since_us = self.last_arrival_us

    def uses(self, event: Report) -> bool:
        """Whether a report is of a message in use; the next best takes over after a silence."""
        sample, message, now_us = event.sample, event.message, event.arrival_us
        kind = type(sample), isinstance(sample, VelocitySample) and sample.late_sigma_s > 0.0
        in_use, last_us = self._reports.get(kind, (message, now_us))
        is_other = message != in_use and report_rank(message) >= report_rank(in_use)
        if is_other and now_us - last_us <= SILENCE_US:
            return False
        self._reports[kind] = (message, now_us)
        return True

    def has_other_clock(self, arrival_us: int, time_us: int) -> bool:
        """Whether a message's clock is another than the IMU's, or there is no IMU yet.

        Some autopilots stamp ATTITUDE seconds off; its rates are then those of another time.
        """
        if self.last is None:
            return True
        age_us, our_age_us = arrival_us - time_us, self.last.arrival_us - self.last.sample.time_us
        return abs(age_us - our_age_us) > OTHER_CLOCK_US


STEADY_SAMPLES = 3  # of a preferred message before it takes over for the first time
SILENT_PERIODS = 20.0  # of the message in use, before another stands in
# A message that has come back from silences counts as gone after this many of the longest one.
SILENCES = 2.0
LONGEST_SILENCE_US = 15_000_000  # in a longer one the link or the vehicle was gone, not the message
STAND_IN_GAP_US = 2_000_000  # a message that pauses for longer cannot stand in


@dataclass(slots=True)
class Candidate:
    """A message that is proving itself beside the one in use."""

    message: str
    since_us: int
    arrival_us: int
    samples: int = 1


class ImuChoice:
    """The message in use, and another one that may replace it."""

    def __init__(self, message: str | None = None) -> None:
        self.message = message
        self.contradicted: set[str] = set()  # those whose gyroscope the estimator contradicts
        self._arrival_us = 0  # the last of the message in use
        self._longest_silence_us = 0  # that it has come back from
        self._has_failed = False  # another IMU has stood in before
        self._candidate: Candidate | None = None

    def patience_us(self, period_us: float) -> float:
        """How long the message in use may be silent, and a returning one must have been back."""
        return max(LATE_MINIMUM_US, SILENT_PERIODS * period_us, SILENCES * self._longest_silence_us)

    def consider(self, message: str, arrival_us: int, period_us: float = 0.0) -> bool:
        """Whether ``message``, which has just arrived, is the one in use now.

        ``period_us`` is the median interval of the message in use.
        """
        if self.message is None:
            self.message, self._arrival_us = message, arrival_us
        elif message == self.message:  # no other message needs to replace it
            silence_us = arrival_us - self._arrival_us
            if self._longest_silence_us < silence_us <= LONGEST_SILENCE_US:
                self._longest_silence_us = silence_us
            self._arrival_us = arrival_us
            other = self._candidate
            if other is not None and self._rank(other.message) >= self._rank(message):
                self._candidate = None
        else:
            self._follow_other(message, arrival_us, period_us)
        return message == self.message

    def _rank(self, message: str) -> tuple[bool, int]:
        """Place of a message in the order of preference."""
        return message in self.contradicted, imu_rank(message)

    def _follow_other(self, message: str, arrival_us: int, period_us: float) -> None:
        """Another message came, which takes over once it has proved itself."""
        is_preferred = self._rank(message) < self._rank(self.message or "")
        stand_in_us = 0 if is_preferred else STAND_IN_GAP_US
        longest_gap_us = max(LATE_MINIMUM_US, LATE_PERIODS * period_us, stand_in_us)
        candidate = self._candidate
        if (
            candidate is None
            or arrival_us - candidate.arrival_us > longest_gap_us
            or self._rank(message) < self._rank(candidate.message)
        ):
            self._candidate = Candidate(message, arrival_us, arrival_us)
            return
        if message != candidate.message:
            return
        candidate.samples += 1
        candidate.arrival_us = arrival_us
        is_long = arrival_us - candidate.since_us >= self.patience_us(period_us)
        is_enough = is_long or (is_preferred and not self._has_failed)
        if candidate.samples >= STEADY_SAMPLES and is_enough:
            self.message, self._arrival_us = message, arrival_us
            self._longest_silence_us, self._candidate = 0, None
            self._has_failed = self._has_failed or not is_preferred
