"""What others know of a vehicle: attitudes, and how far its place and velocity are believed.

Autopilots send what their navigation filter has even while it has nothing: before the first
fix ArduPlane reports a place a few metres from (0, 0), and without satellites its velocity
goes on, metres a second wrong. But the filter also reports its status, and the receiver
whether it has a fix. A filter is believed as far as its status goes; without one, as it stands.
"""

from math import hypot, isfinite, sqrt
from typing import Literal, NamedTuple

from drivers.events import Event, FilterStatus, ReferenceAttitude, VehicleId
from estimator.geometry.frames import from_euler_rad
from estimator.types import Quaternion, Vec3, VelocitySample

# Of messages that report the same, the one to prefer. They are never mixed: velocities differ in
# errors and delays, and a change of source looks like an acceleration. An autopilot's filter
# corrects for the delay of 0.1 to 0.2 s that a receiver's velocity has.
FILTER_VELOCITY = (
    *("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "vehicle_local_position"),
    *("XKF1", "NKF1", "EKF1"),
)
# GPS_RAW_INT is horizontal only
RECEIVER_VELOCITY = ("vehicle_gps_position", "sensor_gps", "GPS", "GPS_RAW_INT")
REPORTS = FILTER_VELOCITY + RECEIVER_VELOCITY


def report_rank(message: str) -> int:
    """Place of a message in the order of preference; those not named come last, all alike."""
    return REPORTS.index(message) if message in REPORTS else len(REPORTS)


def is_receiver(message: str) -> bool:
    """Whether a velocity is a satellite receiver's own, which no filter has worked on."""
    return message in RECEIVER_VELOCITY


FILTER_VELOCITY_SIGMA_M_S = 0.3  # an autopilot's own filter, typical with GPS
RECEIVER_VELOCITY_SIGMA_M_S = 0.5  # a GPS receiver that reports none
RECEIVER_LATE_SIGMA_S = 0.1  # how late it is, is not known better


class Fix(NamedTuple):
    """A message's velocity and position; None for what it does not hold.

    ``velocity_ned_m_s`` has a meaningless third component where ``has_vertical`` is false.
    ``sigma_m_s`` is its accuracy (1 sigma) by the message itself. ``position`` is latitude
    and longitude in degrees (WGS 84) and altitude in m.
    """

    velocity_ned_m_s: Vec3 | None = None
    has_vertical: bool = True
    sigma_m_s: float | None = None
    position: Vec3 | None = None

    @property
    def is_solved(self) -> bool:
        """Whether there is a fix: zero latitude and longitude are a receiver's first reports."""
        if self.position is None:
            return self.velocity_ned_m_s is not None
        latitude_deg, longitude_deg, _ = self.position
        return latitude_deg != 0 or longitude_deg != 0


def velocity_sample(message: str, fix: Fix, time_us: int) -> VelocitySample | None:
    """The velocity that ``message`` shows, at ``time_us``; None if it shows none."""
    velocity, sigma_m_s = fix.velocity_ned_m_s, fix.sigma_m_s
    if velocity is None or not all(map(isfinite, velocity)):
        return None
    late_sigma_s = RECEIVER_LATE_SIGMA_S if is_receiver(message) else 0.0
    if sigma_m_s is None:
        sigma_m_s = RECEIVER_VELOCITY_SIGMA_M_S if late_sigma_s else FILTER_VELOCITY_SIGMA_M_S
    if not isfinite(sigma_m_s):
        return None
    return VelocitySample(time_us, velocity, fix.has_vertical, sigma_m_s, late_sigma_s)


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
MOST_INFLATION = 20.0
# Filters report their status once a second or so; on a radio link it is missing for 25 s.
STATUS_HOLDS_US = 30_000_000
# A place this near to (0, 0) is a displacement from nowhere, unless its sender vouches for it.
NOWHERE_M = 10_000.0
METRES_A_DEGREE = 111_194.9  # of latitude, on a sphere of 6371 km


class Navigation:
    """The last status of one vehicle's receiver and filter; times are those of arrival."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget each status: the vehicle has rebooted."""
        self._filter: FilterStatus | None = None
        self._fix = False, -(1 << 62)  # whether the receiver has one, as of when

    def update_status(
        self,
        vehicle: VehicleId,
        arrival_us: int,
        flags: int,
        velocity_ratio: float,
        compass_ratio: float = 0.0,
    ) -> FilterStatus:
        """Take the filter's status: the bits that all of them share, and its test ratios.

        A ratio that is no number is left out.
        """
        stands = bool(flags & CONSTANT_POSITION)
        self._filter = status = FilterStatus(
            vehicle,
            arrival_us,
            has_velocity=bool(flags & VELOCITY_HORIZONTAL) and not stands,
            has_place=bool(flags & POSITION_ABSOLUTE) and not stands,
            velocity_ratio=velocity_ratio if isfinite(velocity_ratio) else 0.0,
            has_attitude=bool(flags & ATTITUDE),
            compass_ratio=compass_ratio if isfinite(compass_ratio) else 0.0,
        )
        return status

    def update_fix(self, has_fix: bool, arrival_us: int) -> None:
        """Take the receiver's status."""
        self._fix = has_fix, arrival_us

    def velocity_sigma_m_s(self, sigma_m_s: float, arrival_us: int) -> float | None:
        """How certain the filter's velocity is, by itself ``sigma_m_s``; None if it has none."""
        status = self._filter_status(arrival_us)
        if status is None:
            return sigma_m_s
        inflation = GATE_SIGMAS * status.velocity_ratio - (ORDINARY_SIGMAS - 1.0)
        inflation = min(max(1.0, inflation), MOST_INFLATION)
        return sigma_m_s * inflation if status.has_velocity else None

    def accepts_position(self, latitude_deg: float, longitude_deg: float, arrival_us: int) -> bool:
        """Whether the filter's position is one.

        It is if the filter's status has one. Else the receiver must have a fix; where neither has
        reported anything, the position has only to be plausible.
        """
        status = self._filter_status(arrival_us)
        if status is not None and status.has_place:
            return True
        if METRES_A_DEGREE * hypot(latitude_deg, longitude_deg) < NOWHERE_M:
            return False
        has_fix, fix_us = self._fix
        return has_fix if abs(arrival_us - fix_us) <= STATUS_HOLDS_US else status is None

    def _filter_status(self, now_us: int) -> FilterStatus | None:
        """The filter's status, if it still counts."""
        status = self._filter
        counts = status is not None and abs(now_us - status.arrival_us) <= STATUS_HOLDS_US
        return status if counts else None


UNIT_NORM_TOLERANCE = 0.05  # quaternions further from unit length are not attitudes
SAME_BURST_US = 2_000  # messages that are sent together arrive together
MOST_WAITING = 16

Source = Literal["autopilot", "sim"]


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion | None:
    """q_ned_frd of aerospace angles (yaw, then pitch, then roll), or None if one is not finite."""
    angles = roll_rad, pitch_rad, yaw_rad
    return from_euler_rad(*angles) if all(map(isfinite, angles)) else None


def unit_or_none(q: Quaternion) -> Quaternion | None:
    """``q`` at unit length, or None if it is not close to that already (or not finite)."""
    w, x, y, z = q
    norm = sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:  # also refuses NaN
        return None
    return (w / norm, x / norm, y / norm, z / norm)


class UnstampedAttitudes:
    """Gives each the time of the IMU message before it, once: its own was lost otherwise.

    A simulator's may as well have been sent right before its IMU message: unless it comes right
    behind one, it waits for the next, and belongs to that if both come together.
    """

    def __init__(self, vehicle: VehicleId) -> None:
        self._vehicle = vehicle
        self._last: tuple[int, int] | None = None  # time and arrival of the latest IMU sample
        self._waiting: list[tuple[str, int, Quaternion]] = []
        self._given_us: dict[str, int] = {}  # the time that each message has had last

    def imu(self, time_us: int, arrival_us: int) -> list[Event]:
        """A sample has come; the attitudes that have waited for it."""
        last, self._last = self._last, (time_us, arrival_us)
        if not self._waiting or last is None:  # nearly always
            return []
        waiting, self._waiting = self._waiting, []
        events: list[Event] = []
        for name, heard_us, q_ned_frd in waiting:
            is_next = abs(arrival_us - heard_us) <= SAME_BURST_US
            events += self._at(time_us if is_next else last[0], name, heard_us, "sim", q_ned_frd)
        return events

    def end(self) -> list[Event]:
        """No sample comes any more; the attitudes that have waited belong to the last."""
        return [] if self._last is None else self.imu(*self._last)

    def attitude(
        self, name: str, arrival_us: int, source: Source, q_ned_frd: Quaternion
    ) -> list[Event]:
        """An attitude has come; nothing if it has to wait, or belongs to no sample."""
        if self._last is None:
            return []
        time_us, heard_us = self._last
        if source == "autopilot" or arrival_us - heard_us <= SAME_BURST_US:
            return self._at(time_us, name, arrival_us, source, q_ned_frd)
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append((name, arrival_us, q_ned_frd))
        return []

    def _at(
        self, time_us: int, name: str, arrival_us: int, source: Source, q_ned_frd: Quaternion
    ) -> list[Event]:
        if self._given_us.get(name, time_us - 1) >= time_us:
            return []
        self._given_us[name] = time_us
        return [ReferenceAttitude(self._vehicle, arrival_us, time_us, source, name, q_ned_frd)]
