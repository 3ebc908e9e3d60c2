"""Which of a vehicle's messages that report the same helps the estimator.

The best one is used as long as it comes: a change from one message to another would look like a
change of what they report. Velocity has two sources, the autopilot's filter and a receiver; the
estimator models the errors of each, and takes one message of each.
"""

from drivers.events import Report
from drivers.samples.preference import report_rank
from drivers.value import Value
from estimator.types import VelocitySample

SILENCE_US = 2_000_000  # after which the next best takes over

Kind = tuple[type, bool]


class ReportChoice(Value, frozen=True):
    """The message in use and when it last arrived."""

    message: str | None = None
    last_arrival_us: int = 0


def kind_of(event: Report) -> Kind:
    """What one message is chosen of: the type of the report, and whether it is a receiver's."""
    sample = event.sample
    return type(sample), isinstance(sample, VelocitySample) and sample.late_sigma_s > 0.0


def consider(choice: ReportChoice, message: str, arrival_us: int) -> ReportChoice:
    """The choice after ``message`` arrived; it is in use if ``.message`` equals it."""
    if message == choice.message or choice.message is None:
        return ReportChoice(message, arrival_us)
    better = report_rank(message) < report_rank(choice.message)
    silent = arrival_us - choice.last_arrival_us > SILENCE_US
    return ReportChoice(message, arrival_us) if better or silent else choice


class ReportChoices:
    """The choices of one vehicle, one for each kind of report."""

    def __init__(self) -> None:
        self._choices: dict[Kind, ReportChoice] = {}

    def take(self, event: Report) -> bool:
        """Whether the report is of a message in use."""
        kind = kind_of(event)
        before = self._choices.get(kind, ReportChoice())
        choice = self._choices[kind] = consider(before, event.message, event.arrival_us)
        return choice.message == event.message
