"""Which of a vehicle's velocity messages help the estimator.

There are two sources: the autopilot's filter and a receiver. The estimator models the errors of
each, and takes one message of each: a change from one message to another would look like an
acceleration. The best message is used as long as it comes.
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
