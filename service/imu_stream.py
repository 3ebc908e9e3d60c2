"""Which of a vehicle's messages feed the estimator, and how often its IMU comes.

Messages of one vehicle may come from different IMUs, mounted and calibrated differently, so they
are never mixed: one is chosen. Another IMU is a last resort. On a lossy link one message may be
missing for seconds while another's come through, so the chosen one must have been silent for long
while the other came; and it must be back for as long before it is used again. One of whose
gyroscope the estimator has had to doubt comes behind all others from then on.

Of messages that report the same, the best one is used as long as it comes: a change would look like
a change of what they report. Velocity has two sources, the autopilot's filter and a receiver; the
estimator models the errors of each, and takes one message of each.
"""

from collections import Counter, deque

import msgspec

from drivers.events import Imu, Report, Shed
from drivers.mavlink.imu_messages import imu_rank
from drivers.samples.navigation import report_rank
from drivers.value import Value
from estimator.types import ImuSample, VelocitySample
from service import health

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
        self.choice = consider(self.choice, event.message, event.arrival_us, late_us, period_us)
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
        self.choice = trust_all(self.choice)
        self._silent_since_us = last_arrival_us

    def doubt(self) -> None:
        """The gyroscope of the message in use is contradicted: any other message is better."""
        self.choice = doubt(self.choice)

    def _note_gap(self, gap_us: int) -> None:
        self.worst_gap_us = max(self.worst_gap_us, gap_us)


STEADY_SAMPLES = 3  # of a preferred message before it takes over for the first time
SILENT_PERIODS = 20.0  # of the message in use, before another stands in
# A message that has come back from silences counts as gone after this many of the longest one.
SILENCES = 2.0
LONGEST_SILENCE_US = 15_000_000  # in a longer one the link or the vehicle was gone, not the message
STAND_IN_GAP_US = 2_000_000  # a message that pauses for longer cannot stand in


class ImuChoice(Value, frozen=True):
    """The message in use, when it last arrived, and another one that is proving itself.

    ``longest_silence_us`` is what the one in use has come back from, ``has_failed`` says that
    another IMU has stood in before, ``doubted`` names those whose gyroscope was contradicted.
    """

    message: str | None = None
    last_arrival_us: int = 0
    longest_silence_us: int = 0
    has_failed: bool = False
    alternative: str | None = None
    alternative_samples: int = 0
    alternative_since_us: int = 0
    alternative_arrival_us: int = 0
    doubted: tuple[str, ...] = ()

    def rank(self, message: str) -> tuple[bool, int]:
        """Place of a message in the order of preference: the doubted ones come last."""
        return message in self.doubted, imu_rank(message)


def doubt(choice: ImuChoice) -> ImuChoice:
    """The choice once the gyroscope of the message in use is contradicted."""
    if choice.message is None or choice.message in choice.doubted:
        return choice
    return msgspec.structs.replace(choice, doubted=(*choice.doubted, choice.message))


def trust_all(choice: ImuChoice) -> ImuChoice:
    """The choice after a reboot, which may have mended what was doubted."""
    return msgspec.structs.replace(choice, doubted=())


def patience_us(choice: ImuChoice, late_after_us: float, period_us: float) -> float:
    """How long the message in use may be silent, and a returning one must have been back."""
    return max(late_after_us, SILENT_PERIODS * period_us, SILENCES * choice.longest_silence_us)


def consider(
    choice: ImuChoice, message: str, arrival_us: int, late_after_us: float, period_us: float = 0.0
) -> ImuChoice:
    """The choice after ``message`` arrived; it is in use if ``.message`` equals it.

    ``late_after_us`` is the silence after which the message in use is late, ``period_us`` its
    median interval.
    """
    if choice.message is None:
        return ImuChoice(message, arrival_us)
    if message == choice.message:
        return _follow_own(choice, arrival_us)
    is_preferred = choice.rank(message) < choice.rank(choice.message)
    longest_gap_us = late_after_us if is_preferred else max(late_after_us, STAND_IN_GAP_US)
    choice = _follow_rival(choice, message, arrival_us, longest_gap_us)
    if choice.alternative != message:
        return choice
    lasts_us = arrival_us - choice.alternative_since_us
    is_long = lasts_us >= patience_us(choice, late_after_us, period_us)
    is_steady = choice.alternative_samples >= STEADY_SAMPLES
    if is_steady and (is_long or (is_preferred and not choice.has_failed)):
        has_failed = choice.has_failed or not is_preferred
        return ImuChoice(message, arrival_us, has_failed=has_failed, doubted=choice.doubted)
    return choice


def longest_silence_us(longest_us: int, silence_us: int) -> int:
    """The longest silence that a message has come back from, after one more."""
    return silence_us if longest_us < silence_us <= LONGEST_SILENCE_US else longest_us


def _follow_own(choice: ImuChoice, arrival_us: int) -> ImuChoice:
    """The message in use came: nobody needs to stand in for it."""
    longest_us = longest_silence_us(choice.longest_silence_us, arrival_us - choice.last_arrival_us)
    alternative = choice.alternative
    if alternative is not None and choice.rank(alternative) >= choice.rank(choice.message or ""):
        alternative = None
    # field by field: msgspec.structs.replace takes three times as long, at every sample
    return ImuChoice(
        choice.message,
        arrival_us,
        longest_us,
        choice.has_failed,
        alternative,
        choice.alternative_samples,
        choice.alternative_since_us,
        choice.alternative_arrival_us,
        choice.doubted,
    )


def _follow_rival(
    choice: ImuChoice, message: str, arrival_us: int, longest_gap_us: float
) -> ImuChoice:
    """Another message came: make it the rival, unless a better message is the rival already."""
    goes_on = arrival_us - choice.alternative_arrival_us <= longest_gap_us
    if choice.alternative == message and goes_on:
        return msgspec.structs.replace(
            choice,
            alternative_samples=choice.alternative_samples + 1,
            alternative_arrival_us=arrival_us,
        )
    is_other = choice.alternative not in (None, message)
    if is_other and goes_on and choice.rank(message) >= choice.rank(choice.alternative or ""):
        return choice
    return msgspec.structs.replace(
        choice,
        alternative=message,
        alternative_samples=1,
        alternative_since_us=arrival_us,
        alternative_arrival_us=arrival_us,
    )


SILENCE_US = 2_000_000  # after which the next best takes over

Kind = tuple[type, bool]


class ReportChoice(Value, frozen=True):
    """The message in use and when it last arrived."""

    message: str
    last_arrival_us: int


def kind_of(event: Report) -> Kind:
    """What one message is chosen of: the type of the report, and whether it is a receiver's."""
    sample = event.sample
    return type(sample), isinstance(sample, VelocitySample) and sample.late_sigma_s > 0.0


class ReportChoices:
    """The choices of one vehicle, one for each kind of report."""

    def __init__(self) -> None:
        self._choices: dict[Kind, ReportChoice] = {}

    def take(self, event: Report) -> bool:
        """Whether the report is of a message in use."""
        kind, message, now_us = kind_of(event), event.message, event.arrival_us
        choice = self._choices.get(kind)
        if choice is not None and message != choice.message:
            is_better = report_rank(message) < report_rank(choice.message)
            if not is_better and now_us - choice.last_arrival_us <= SILENCE_US:
                return False
        self._choices[kind] = ReportChoice(message, now_us)
        return True
