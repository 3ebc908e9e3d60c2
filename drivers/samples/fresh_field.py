"""A magnetometer that is logged beside the IMU, handed to the IMU samples."""

from drivers.samples.imu_checks import MagMemory
from estimator.types import ZERO_VEC3, ImuSample, Vec3

STALE_US = 200_000  # an older field no longer belongs to the IMU sample after it


class FreshField:
    """Gives each magnetic reading once, to the first IMU sample of a stream behind it."""

    def __init__(self) -> None:
        self._memory = MagMemory()
        self._mag_gauss: Vec3 = ZERO_VEC3
        self._raw_us = 0
        self._number = 0
        self._given: dict[str, int] = {}

    def put(self, mag_gauss: Vec3, raw_us: int) -> None:
        """Take a reading in, with its time on the log's clock; a zero one is dropped."""
        fresh = self._memory.fresh(mag_gauss, raw_us)
        if fresh is not None:
            self._mag_gauss, self._raw_us = fresh, raw_us
            self._number += 1

    def sample(self, stream: str, raw_us: int, time_us: int, gyr: Vec3, acc: Vec3) -> ImuSample:
        """The IMU sample of ``stream`` at ``raw_us`` on the log's clock, with the field if new."""
        is_new = self._given.get(stream, 0) != self._number
        has_mag = is_new and abs(raw_us - self._raw_us) <= STALE_US
        if has_mag:
            self._given[stream] = self._number
        return ImuSample(time_us, gyr, acc, self._mag_gauss if has_mag else ZERO_VEC3, has_mag)
