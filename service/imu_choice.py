"""Which of a vehicle's IMU messages feeds the estimator.

Messages of one vehicle may come from different IMUs, mounted and calibrated differently, so
they are never mixed: one is chosen. Another IMU is a last resort. On a lossy link one message
may be missing for seconds while another's come through, so the chosen one must have been silent
for long while the other came; and it must be back for as long before it is used again. One of
whose gyroscope the estimator has had to doubt comes behind all others from then on.
"""

import msgspec

from drivers.mavlink.imu_messages import imu_rank
from drivers.value import Value

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
    rival: str | None = None
    rival_samples: int = 0
    rival_since_us: int = 0
    rival_arrival_us: int = 0
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
    if choice.rival != message:
        return choice
    lasts_us = arrival_us - choice.rival_since_us
    is_long = lasts_us >= patience_us(choice, late_after_us, period_us)
    is_steady = choice.rival_samples >= STEADY_SAMPLES
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
    rival = choice.rival
    if rival is not None and choice.rank(rival) >= choice.rank(choice.message or ""):
        rival = None
    # field by field: msgspec.structs.replace takes three times as long, at every sample
    return ImuChoice(
        choice.message,
        arrival_us,
        longest_us,
        choice.has_failed,
        rival,
        choice.rival_samples,
        choice.rival_since_us,
        choice.rival_arrival_us,
        choice.doubted,
    )


def _follow_rival(
    choice: ImuChoice, message: str, arrival_us: int, longest_gap_us: float
) -> ImuChoice:
    """Another message came: make it the rival, unless a better message is the rival already."""
    goes_on = arrival_us - choice.rival_arrival_us <= longest_gap_us
    if choice.rival == message and goes_on:
        return msgspec.structs.replace(
            choice, rival_samples=choice.rival_samples + 1, rival_arrival_us=arrival_us
        )
    is_other = choice.rival not in (None, message)
    if is_other and goes_on and choice.rank(message) >= choice.rank(choice.rival or ""):
        return choice
    return msgspec.structs.replace(
        choice,
        rival=message,
        rival_samples=1,
        rival_since_us=arrival_us,
        rival_arrival_us=arrival_us,
    )
