"""Which of a vehicle's IMU messages feeds the estimator.

Messages of one vehicle may come from different IMUs, mounted and calibrated
differently, so they are never mixed: one is chosen, and another takes over
only when the chosen one goes silent or a preferred one proves steady.
"""

import msgspec

from drivers.samples.preference import imu_rank
from drivers.value import Value

STEADY_SAMPLES = 3  # of a preferred message before it takes over


class ImuChoice(Value, frozen=True):
    """The message in use, when it last arrived, and a preferred one that is proving itself."""

    message: str | None = None
    last_arrival_us: int = 0
    candidate: str | None = None
    candidate_samples: int = 0
    candidate_arrival_us: int = 0


def consider(choice: ImuChoice, message: str, arrival_us: int, late_after_us: float) -> ImuChoice:
    """The choice after ``message`` arrived; it is in use if ``.message`` equals it.

    ``late_after_us`` is the silence after which the message in use has failed.
    """
    if choice.message is None:
        return ImuChoice(message, arrival_us)
    if message == choice.message:
        return msgspec.structs.replace(choice, last_arrival_us=arrival_us)
    if arrival_us - choice.last_arrival_us > late_after_us:
        return ImuChoice(message, arrival_us)
    if imu_rank(message) >= imu_rank(choice.message):
        return choice
    steady = (
        choice.candidate == message and arrival_us - choice.candidate_arrival_us <= late_after_us
    )
    count = choice.candidate_samples + 1 if steady else 1
    if count >= STEADY_SAMPLES:
        return ImuChoice(message, arrival_us)
    return msgspec.structs.replace(
        choice, candidate=message, candidate_samples=count, candidate_arrival_us=arrival_us
    )
