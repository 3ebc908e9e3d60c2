"""How far a vehicle's word on its place and its velocity is believed.

Autopilots send what their navigation filter has even while it has nothing: before the first
fix ArduPlane reports a place a few metres from (0, 0), and without satellites its velocity
goes on, metres a second wrong. But the filter also says how it is doing, and the receiver
whether it has a fix. A filter is believed as far as it believes itself; one that never says
anything of itself is believed as it stands.
"""

from math import hypot, isfinite
from typing import NamedTuple

from drivers.events import FilterStatus

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


class Said(NamedTuple):
    """What somebody reported last, and when it arrived."""

    is_so: bool
    arrival_us: int

    def holds(self, now_us: int) -> bool:
        """Whether it still counts."""
        return abs(now_us - self.arrival_us) <= WORD_HOLDS_US


def is_nowhere(latitude_deg: float, longitude_deg: float) -> bool:
    """Whether a place is so near to (0, 0) that it is none, in all likelihood."""
    return METRES_A_DEGREE * hypot(latitude_deg, longitude_deg) < NOWHERE_M


class Navigation:
    """The last words of one vehicle's receiver and filter; times are those of arrival."""

    def __init__(self) -> None:
        self._velocity: Said | None = None  # whether the filter has one
        self._place: Said | None = None
        self._fix: Said | None = None  # whether the receiver has one
        self._doubt = 1.0  # what the filter's sigma of its velocity is to be multiplied by

    def forget(self) -> None:
        """The vehicle has rebooted: what it said before says nothing now."""
        self._velocity = self._place = self._fix = None

    def hear_status(self, status: FilterStatus, arrival_us: int) -> None:
        """The filter spoke of itself."""
        self._velocity = Said(status.has_velocity, arrival_us)
        self._place = Said(status.has_place, arrival_us)
        doubt = GATE_SIGMAS * status.velocity_ratio - (ORDINARY_SIGMAS - 1.0)
        self._doubt = min(max(1.0, doubt), MOST_DOUBT)

    def hear_fix(self, has_fix: bool, arrival_us: int) -> None:
        """The receiver spoke."""
        self._fix = Said(has_fix, arrival_us)

    def velocity_sigma_m_s(self, sigma_m_s: float, arrival_us: int) -> float | None:
        """How certain the filter's velocity is, by itself ``sigma_m_s``; None if it has none."""
        said = self._velocity
        if said is None or not said.holds(arrival_us):
            return sigma_m_s
        return sigma_m_s * self._doubt if said.is_so else None

    def believes_place(self, latitude_deg: float, longitude_deg: float, arrival_us: int) -> bool:
        """Whether the filter's place is one.

        It is where the filter says that it knows its place. Where it does not, the receiver
        must have a fix; where neither ever said anything, the place has only to be plausible.
        """
        place, fix = self._place, self._fix
        has_status = place is not None and place.holds(arrival_us)
        if has_status and place is not None and place.is_so:
            return True
        if is_nowhere(latitude_deg, longitude_deg):
            return False
        return fix.is_so if fix is not None and fix.holds(arrival_us) else not has_status
