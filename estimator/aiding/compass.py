"""Whether a compass may give the heading: what is known about its calibration, and since when.

Somebody may have said; its field may look unlike the place's own; and an aiding that begins with
its heading may have to give up, again and again. What was only seen holds for a while: a vehicle
that has stood beside iron, or tilted, gets another chance.
"""

from typing import NamedTuple

# The aiding that gives up again after less than this has begun with the wrong heading.
AGAIN_US = 60_000_000
# A compass that has misled it is taken for a stranger's for so long.
DISTRUST_US = 600_000_000
# A field that was unlike the place's own must have looked like it for so long.
UNLIKE_US = 30_000_000


class Compass(NamedTuple):
    """What is known of it; the times (vehicle's clock) are None where it never happened."""

    declared_calibrated: bool = True  # assumed until told otherwise
    unlike_us: int | None = None  # its field was last seen to be unlike the place's own
    gave_up_us: int | None = None  # the aiding last gave up
    misled_us: int | None = None  # it last gave up twice in a row


def is_trusted(compass: Compass, time_us: int) -> bool:
    """Whether its field is trusted at ``time_us``."""
    return (
        compass.declared_calibrated
        and not _is_recent(compass.unlike_us, time_us, UNLIKE_US)
        and not _is_recent(compass.misled_us, time_us, DISTRUST_US)
    )


def declare(compass: Compass, is_calibrated: bool) -> Compass:
    """After somebody has said; only news changes what was seen before."""
    if is_calibrated == compass.declared_calibrated:
        return compass
    return Compass(declared_calibrated=is_calibrated)


def record_giving_up(compass: Compass, time_us: int) -> Compass:
    """After the aiding has given up. Twice in a row, and the compass is not what it seemed."""
    if _is_recent(compass.gave_up_us, time_us, AGAIN_US):
        compass = compass._replace(misled_us=time_us)
    return compass._replace(gave_up_us=time_us)


def restart(compass: Compass) -> Compass:
    """After a reboot, whose clock begins anew: only what somebody has said still holds."""
    return Compass(declared_calibrated=compass.declared_calibrated)


def _is_recent(then_us: int | None, time_us: int, for_us: int) -> bool:
    return then_us is not None and time_us - then_us < for_us
