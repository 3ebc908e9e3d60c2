"""How a vehicle's other IMUs differ from the one in use, so that people see which sensor is bad."""

from math import degrees, isfinite

from drivers.events import Imu
from estimator.geometry.quaternion import angle_between_vectors, norm, subtract
from estimator.types import ZERO_VEC3, Vec3
from service.evidence import towards
from service.records import ImuDifference

LOOK_EVERY_US = 500_000
LOOKS = 20  # of the means: ten seconds, over which readings that are some ms apart agree
SILENT_US = 5_000_000  # one that has not come for so long is not shown
APART_US = 250_000  # arrivals of readings that are compared


class _Means:
    """Of one IMU and ours, as the vehicle sends both."""

    looked_us = looks = 0
    force = our_force = ZERO_VEC3  # m/s^2
    rate = ZERO_VEC3  # less ours, rad/s


class OtherImus:
    """Compares twice a second of the host's clock."""

    def __init__(self) -> None:
        self._means: dict[str, _Means] = {}  # by message

    def take(
        self, message: str, arrival_us: int, rate: Vec3, force: Vec3, ours: Imu | None
    ) -> None:
        """Take a reading (rad/s, m/s^2) of another IMU, if it is time."""
        means = self._means.get(message)
        if means is not None and 0 <= arrival_us - means.looked_us < LOOK_EVERY_US:
            return
        if ours is None or abs(arrival_us - ours.arrival_us) > APART_US:
            return
        if not isfinite(sum((*rate, *force))):
            return
        means = self._means.setdefault(message, _Means())
        means.looked_us = arrival_us
        means.looks += 1
        share = 1.0 / min(means.looks, LOOKS)
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
            if now_us - each.looked_us < SILENT_US and norm(each.force) > 0.0
        }
