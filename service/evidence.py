"""What force, velocity and field show of an attitude, and how other IMUs differ."""

from math import atan2, degrees, exp, hypot, isfinite, remainder

from drivers.events import Imu, OtherImu
from estimator.aiding.compass import resembles
from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import add, angle_between_vectors, norm, rotate, scale, subtract
from estimator.types import ZERO_VEC3, ImuSample, Quaternion, Vec3
from service.records import ImuDifference


def towards(mean: Vec3 | None, value: Vec3, share: float) -> Vec3:
    """A running mean with one more value, which counts by ``share``."""
    return value if mean is None else add(mean, scale(share, subtract(value, mean)))


def off_north_deg(field_ned: Vec3, declination_rad: float) -> float:
    """How far an attitude's heading is off, if the field that it sees points to magnetic north."""
    north, east, _ = field_ned
    return remainder(degrees(atan2(east, north) - declination_rad), 360.0)


BEGIN_SHARE, END_SHARE = 0.6, 0.3


class Persistence:
    """The share of time for which a condition holds, with a time constant of ``patience_s``.

    It is on from 0.6 on, so after 0.92 of that time for a constant condition, until 0.3: a start
    or a magnet that passes is too short.
    """

    def __init__(self, patience_s: float) -> None:
        self.share = 0.0  # below zero for the opposite condition
        self.is_on = False
        self._patience_s = patience_s

    def look(self, is_so: int, dt_s: float) -> None:
        """Take ``dt_s`` with the condition (1), without it (0), or with its opposite (-1)."""
        self.share += dt_s / (self._patience_s + dt_s) * (is_so - self.share)
        self.is_on = abs(self.share) > (END_SHARE if self.is_on else BEGIN_SHARE)


CONSISTENCY_S = 20.0  # memory of the evidence
# So much horizontal acceleration (m/s^2) shows a heading.
LEAST_GAIN_M_S2 = 0.7
VELOCITY = "velocity"
STRIDE_US = 1_000_000  # velocity's gain and the force are compared over so long
# What has not come for so long, velocity or an autopilot's attitude, is not compared.
SILENT_US = 2_000_000


class Consistency:
    """What force, velocity and field have shown of one attitude over the last seconds."""

    def __init__(self) -> None:
        self._weight = 0.0
        self._force = self._field = ZERO_VEC3  # means, NED
        self._gained = ZERO_VEC3  # mean acceleration by velocity, NED
        self._turn = ZERO_VEC3  # mean of what is across and along of it, and of its square
        self._stride = ZERO_VEC3  # velocity that the force has given since
        self._begun: tuple[int, Vec3] | None = None  # this time and velocity

    def look(self, q: Quaternion, sample: ImuSample, dt_s: float) -> None:
        """Take the force and the field as the attitude ``q`` sees them."""
        share = 1.0 - exp(-dt_s / CONSISTENCY_S)
        force = rotate(q, sample.acc_m_s2)
        self._force = towards(self._force, force, share)
        if sample.has_mag:
            self._field = towards(self._field, rotate(q, sample.mag_gauss), share)
        self._weight += share * (1.0 - self._weight)
        self._stride = add(self._stride, scale(dt_s, force))

    def take_velocity(self, time_us: int, velocity: Vec3) -> None:
        """Compare, once a second, what the force has given with what velocity has gained."""
        begun_us, begun = self._begun or (time_us, velocity)
        passed_us = time_us - begun_us
        if 0 < passed_us < STRIDE_US:
            return
        if STRIDE_US <= passed_us < SILENT_US:
            dt_s = 1e-6 * passed_us
            share = 1.0 - exp(-dt_s / CONSISTENCY_S)
            gained = subtract(velocity, begun)
            self._gained = towards(self._gained, scale(1.0 / dt_s, gained), share)
            (x, y, _), (u, v, _) = self._stride, gained
            turn = (x * v - y * u, x * u + y * v, u * u + v * v)
            self._turn = towards(self._turn, scale(1.0 / dt_s**2, turn), share)
        self._begun, self._stride = (time_us, velocity), ZERO_VEC3

    def held_m_s2(self) -> Vec3:
        """The mean force less the velocity gained meanwhile, which should point up."""
        return subtract(scale(1.0 / max(self._weight, 1e-9), self._force), self._gained)

    def dip_deg(self, place: PlaceField | None) -> float | None:
        """How far the mean field's dip is off the place's; None where either is not known."""
        north, east, down = self._field
        if place is None or not any(self._field):
            return None
        return abs(degrees(atan2(down, hypot(north, east)) - place.dip_rad))

    def turn_deg(self, place: PlaceField | None) -> tuple[float, str] | None:
        """How far (deg) the heading is off by velocity, else by the field; None if unknown."""
        across, along, square = self._turn
        if square > LEAST_GAIN_M_S2**2:
            return degrees(abs(atan2(across, along))), VELOCITY
        north, east, down = self._field
        if place is None or not resembles(place, hypot(north, east), down):
            return None
        return abs(off_north_deg(self._field, place.declination_rad)), "the magnetic field"


IMU_LOOK_EVERY_US = 500_000
IMU_LOOKS = 20  # of the means: ten seconds, over which readings that are some ms apart agree
IMU_SILENT_US = 5_000_000  # one that has not come for so long is not shown
APART_US = 250_000  # arrivals of readings that are compared


class _Means:
    """Of one IMU and ours, as the vehicle sends both."""

    looked_us = looks = 0
    force = our_force = ZERO_VEC3  # m/s^2
    rate = ZERO_VEC3  # less ours, rad/s


class OtherImus:
    """How a vehicle's other IMUs differ from the one in use: which sensor is bad.

    Compares twice a second of the host's clock.
    """

    def __init__(self) -> None:
        self._means: dict[str, _Means] = {}  # by message

    def take(self, other: OtherImu, ours: Imu | None) -> None:
        """Take a reading of another IMU, if it is time."""
        arrival_us, means = other.arrival_us, self._means.get(other.message)
        if means is not None and 0 <= arrival_us - means.looked_us < IMU_LOOK_EVERY_US:
            return
        rate, force = other.rate_rad_s, other.force_m_s2
        is_finite = isfinite(sum((*rate, *force)))
        if ours is None or abs(arrival_us - ours.arrival_us) > APART_US or not is_finite:
            return
        means = self._means.setdefault(other.message, _Means())
        means.looked_us = arrival_us
        means.looks += 1
        share = 1.0 / min(means.looks, IMU_LOOKS)
        means.force = towards(means.force, force, share)
        means.our_force = towards(means.our_force, ours.sample.acc_m_s2, share)
        means.rate = towards(means.rate, subtract(rate, ours.sample.gyr_rad_s), share)

    def records(self, now_us: int) -> dict[str, ImuDifference]:
        """The differences of those that still come, by message."""
        return {
            message: ImuDifference(
                round(degrees(angle_between_vectors(each.force, each.our_force)), 2),
                round(degrees(norm(each.rate)), 2),
            )
            for message, each in sorted(self._means.items())
            if now_us - each.looked_us < IMU_SILENT_US and norm(each.force) > 0.0
        }
