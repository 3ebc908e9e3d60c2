"""Which of a vehicle's velocity messages help the estimator.

There are two sources: the autopilot's filter and a receiver. The estimator knows the errors of
either; the messages of one are never mixed, for a change looks like an acceleration. The better
one is used while it comes.
"""

from drivers.samples.preference import velocity_rank
from drivers.value import Value

SILENCE_US = 2_000_000  # after which the next best takes over


class VelocityChoice(Value, frozen=True):
    """The message in use and when it last arrived."""

    message: str | None = None
    last_arrival_us: int = 0


def consider(choice: VelocityChoice, message: str, arrival_us: int) -> VelocityChoice:
    """The choice after ``message`` arrived; it is in use if ``.message`` equals it."""
    better = choice.message is None or velocity_rank(message) < velocity_rank(choice.message)
    silent = arrival_us - choice.last_arrival_us > SILENCE_US
    if better or silent or message == choice.message:
        return VelocityChoice(message, arrival_us)
    return choice
