"""How far a vehicle's word on its place and its velocity is believed.

Autopilots send what their navigation filter has even while it has nothing: before the first
fix ArduPlane reports a place a few metres from (0, 0), and without satellites its velocity
goes on, metres a second wrong. But the filter also says how it is doing, and the receiver
whether it has a fix. A filter is believed as far as it believes itself; one that never says
anything of itself is believed as it stands.
"""

from math import hypot, isfinite
from typing import Any

from drivers.events import FilterStatus
from estimator.compilation.compiled import inlined

# What EKF_STATUS_REPORT, ESTIMATOR_STATUS, DataFlash's XKF4.SS and ULog's solution_status_flags
# agree on: https://mavlink.io/en/messages/ardupilotmega.html#EKF_STATUS_FLAGS
ATTITUDE = 0x01
VELOCITY_HORIZONTAL = 0x02
POSITION_ABSOLUTE = 0x10
CONSTANT_POSITION = 0x80  # nothing but the IMU and the guess that the vehicle stands

# The filters' gates are 5 sigma wide (EK3_VEL_I_GATE, EKF2_GPS_V_GATE), and a test ratio is an
# innovation's share of its gate. Two sigma are ordinary; beyond them the velocity is as many
# times less certain.
GATE_SIGMAS = 5.0
ORDINARY_SIGMAS = 2.0
MOST_DOUBT = 20.0
# Filters speak of themselves once a second or so; on a radio link words are missing for 25 s.
WORD_HOLDS_US = 30_000_000
# A place this near to (0, 0) is a displacement from nowhere, unless its sender vouches for it.
NOWHERE_M = 10_000.0
METRES_A_DEGREE = 111_194.9  # of latitude, on a sphere of 6371 km


def filter_status(flags: int, velocity_ratio: float, compass_ratio: float = 0.0) -> FilterStatus:
    """From the bits that all of them share; a ratio that is no number says nothing."""
    stands = bool(flags & CONSTANT_POSITION)
    return FilterStatus(
        has_velocity=bool(flags & VELOCITY_HORIZONTAL) and not stands,
        has_place=bool(flags & POSITION_ABSOLUTE) and not stands,
        velocity_ratio=velocity_ratio if isfinite(velocity_ratio) else 0.0,
        has_attitude=bool(flags & ATTITUDE),
        compass_ratio=compass_ratio if isfinite(compass_ratio) else 0.0,
    )


# What was said last, each 1, 0, or :data:`UNSAID`, and when it arrived.
Words = Any  # a list of whole numbers, or a row of an array
UNSAID = -1
STATUS_US, HAS_VELOCITY, HAS_PLACE, FIX_US, HAS_FIX = 0, 1, 2, 3, 4
WORDS = 5


@inlined
def holds(word: int, said_us: int, now_us: int) -> bool:
    """Whether something was said that still counts."""
    return word != UNSAID and abs(now_us - said_us) <= WORD_HOLDS_US


@inlined
def velocity_doubt(words: Words, doubt: float, arrival_us: int) -> float:
    """What a filter's sigma of its velocity is to be multiplied by; negative if it has none."""
    if not holds(words[HAS_VELOCITY], words[STATUS_US], arrival_us):
        return 1.0
    return doubt if words[HAS_VELOCITY] == 1 else -1.0


@inlined
def believes_place(
    words: Words, latitude_deg: float, longitude_deg: float, arrival_us: int
) -> bool:
    """Whether the filter's place is one.

    It is where the filter says that it knows its place. Where it does not, the receiver
    must have a fix; where neither ever said anything, the place has only to be plausible.
    """
    has_status = holds(words[HAS_PLACE], words[STATUS_US], arrival_us)
    if has_status and words[HAS_PLACE] == 1:
        return True
    if is_nowhere(latitude_deg, longitude_deg):
        return False
    if holds(words[HAS_FIX], words[FIX_US], arrival_us):
        return bool(words[HAS_FIX] == 1)
    return not has_status


@inlined
def is_nowhere(latitude_deg: float, longitude_deg: float) -> bool:
    """Whether a place is so near to (0, 0) that it is none, in all likelihood."""
    return METRES_A_DEGREE * hypot(latitude_deg, longitude_deg) < NOWHERE_M


class Navigation:
    """The last words of one vehicle's receiver and filter; times are those of arrival.

    ``words`` and ``doubt`` are what the functions here take.
    """

    def __init__(self) -> None:
        self.words = [0, UNSAID, UNSAID, 0, UNSAID]
        self.doubt = 1.0

    def forget(self) -> None:
        """The vehicle has rebooted: what it said before says nothing now."""
        self.words[:] = [0, UNSAID, UNSAID, 0, UNSAID]

    def hear_status(self, status: FilterStatus, arrival_us: int) -> None:
        """The filter spoke of itself."""
        self.words[:FIX_US] = [arrival_us, int(status.has_velocity), int(status.has_place)]
        doubt = GATE_SIGMAS * status.velocity_ratio - (ORDINARY_SIGMAS - 1.0)
        self.doubt = min(max(1.0, doubt), MOST_DOUBT)

    def hear_fix(self, has_fix: bool, arrival_us: int) -> None:
        """The receiver spoke."""
        self.words[FIX_US:] = [arrival_us, int(has_fix)]

    def velocity_sigma_m_s(self, sigma_m_s: float, arrival_us: int) -> float | None:
        """How certain the filter's velocity is, by itself ``sigma_m_s``; None if it has none."""
        doubt = velocity_doubt(self.words, self.doubt, arrival_us)
        return None if doubt < 0.0 else sigma_m_s * doubt

    def believes_place(self, latitude_deg: float, longitude_deg: float, arrival_us: int) -> bool:
        """See :func:`believes_place`."""
        return believes_place(self.words, latitude_deg, longitude_deg, arrival_us)
