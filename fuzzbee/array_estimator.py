"""The estimator as programs use it: readings as arrays, one sample a call or all at once."""

from collections import Counter
from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.samples.fresh_field import RepeatedField, finite_or_zero
from estimator import estimator
from estimator.errors import InputError
from estimator.profile import Profile, load_profile
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, Attitude, ImuSample, Vec3, VelocitySample
from fuzzbee.attitudes import NO_ATTITUDE, Attitudes, attitude_arrays

Floats = NDArray[np.float64]

MICROSECONDS = 1e6
# What a satellite receiver's or an autopilot's velocity is good for if nobody says.
VELOCITY_SIGMA_M_S = 0.3
NO_TIME = "an estimator without rate_hz needs time_s with every sample"


class Estimator:
    """One vehicle's attitude from its gyroscope, accelerometer and, if there is one, magnetometer.

    Body axes are forward, right, down (FRD), the inertial ones north, east, down (NED). The
    accelerometer gives the specific force: (0, 0, -9.8) m/s^2 where the vehicle stands level.
    The magnetometer's unit is the gauss (1 uT is 0.01 gauss).

    Args:
        profile: what ``load_profile`` gives, or the name or file it would be given.
        rate_hz: samples a second, for data whose samples have no times of their own.
        gain: fixes K, the gain that otherwise the profile's rules set.

    Raises:
        InputError: an unusable profile, rate or gain.
    """

    def __init__(
        self,
        profile: Profile | str = "imu",
        rate_hz: float | None = None,
        *,
        gain: float | None = None,
    ) -> None:
        if rate_hz is not None and not (isfinite(rate_hz) and rate_hz > 0.0):
            raise InputError(f"rate_hz {rate_hz:g}: must be a number of samples a second above 0")
        if gain is not None and not (isfinite(gain) and gain >= 0.0):
            raise InputError(f"gain {gain:g}: must be a number, 0 or more")
        self.profile = load_profile(profile) if isinstance(profile, str) else profile
        self.rejected: Counter[str] = Counter()  # samples and reports that were refused, by reason
        self._inner = estimator.Estimator(self.profile, gain)
        self._rate_hz = rate_hz
        self._number = 0  # of the next sample
        self._last_us = 0  # the time of the last one
        self._field = RepeatedField()

    def update(
        self,
        gyr_rad_s: ArrayLike,
        acc_m_s2: ArrayLike,
        mag_gauss: ArrayLike | None = None,
        time_s: float | None = None,
    ) -> Attitude | None:
        """Take one sample, (3,) each; the attitude then.

        A sample that cannot be used is counted in ``rejected``, and the attitude goes on as it
        turned last; before the first that can be used there is none. A field that is zero, not
        finite or the same as before is taken for none.

        Raises:
            InputError: neither ``time_s`` nor a rate is given, or a reading has not three numbers.
        """
        readings = (_vector("gyr_rad_s", gyr_rad_s), _vector("acc_m_s2", acc_m_s2))
        mag = ZERO_VEC3 if mag_gauss is None else _vector("mag_gauss", mag_gauss)
        return self._take(self._next_us(time_s), *readings, mag)

    def update_velocity(
        self,
        velocity_ned_m_s: ArrayLike,
        time_s: float | None = None,
        sigma_m_s: float = VELOCITY_SIGMA_M_S,
    ) -> None:
        """Take a velocity over ground (3,), by a receiver or whoever knows it.

        It tells acceleration from gravity and shows the heading. ``time_s`` is the time that it
        was measured at, without which it is that of the last sample; a third component of NaN
        is unknown. One that cannot be used is counted in ``rejected``.

        Raises:
            InputError: it has not three numbers.
        """
        north, east, down = _vector("velocity_ned_m_s", velocity_ned_m_s)
        time_us = self._last_us if time_s is None else _microseconds(time_s)
        has_down = isfinite(down)
        velocity = (north, east, down if has_down else 0.0)
        reason = self._inner.update_velocity(VelocitySample(time_us, velocity, has_down, sigma_m_s))
        self._count(reason)

    def update_batch(
        self,
        gyr_rad_s: ArrayLike,
        acc_m_s2: ArrayLike,
        mag_gauss: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        velocity_ned_m_s: ArrayLike | None = None,
    ) -> Attitudes:
        """Take N samples, (N, 3) each; the attitude after each of them.

        The same as N calls of ``update``, each after one of ``update_velocity`` where that row of
        ``velocity_ned_m_s`` is known: rows of NaN stand for no report, and for no field.
        ``time_s`` (N,) is needed without a rate.

        Raises:
            InputError: arrays of other shapes, or no times.
        """
        gyr = _matrix("gyr_rad_s", gyr_rad_s)
        n = len(gyr)
        acc = _matrix("acc_m_s2", acc_m_s2, n)
        mag = np.zeros((n, 3)) if mag_gauss is None else _matrix("mag_gauss", mag_gauss, n)
        reports = _reports(velocity_ned_m_s, n)
        times: Sequence[float | None] = [None] * n if time_s is None else _times(time_s, n)
        found: list[Attitude] = []
        rows = zip(times, _tuples(gyr), _tuples(acc), _tuples(mag), reports, strict=True)
        for time, gyr_row, acc_row, mag_row, report in rows:
            time_us = self._next_us(time)
            if report is not None:
                self.update_velocity(report, time_us / MICROSECONDS)
            attitude = self._take(time_us, gyr_row, acc_row, mag_row)
            found.append(attitude or NO_ATTITUDE._replace(time_us=time_us))
        return attitude_arrays(found)

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_s: float
    ) -> None:
        """Where and when this is: the heading is from true north then (World Magnetic Model)."""
        self._inner.set_position(
            latitude_deg, longitude_deg, altitude_m, round(MICROSECONDS * unix_s)
        )

    def _take(self, time_us: int, gyr: Vec3, acc: Vec3, mag: Vec3) -> Attitude | None:
        """One sample; the attitude after it, if there is any yet."""
        inner = self._inner
        field = self._field.fresh(finite_or_zero(mag), time_us, time_us)
        sample = ImuSample(time_us, gyr, acc, field or ZERO_VEC3, field is not None)
        self._count(inner.update(self.profile.mounting.to_body_axes(sample)))
        if not inner.aligned:
            return None
        attitude = inner.attitude(time_us)
        if all(map(isfinite, attitude.q_ned_frd)):
            return attitude
        self._count(Reason.ESTIMATE_NOT_FINITE)  # no sample would repair it: it aligns anew
        inner.restart()
        return None

    def _next_us(self, time_s: float | None) -> int:
        """The time of the next sample, given or by its number."""
        if time_s is not None:
            self._last_us = _microseconds(time_s)
        elif self._rate_hz is None:
            raise InputError(NO_TIME)
        else:
            self._last_us = round(MICROSECONDS * self._number / self._rate_hz)
        self._number += 1
        return self._last_us

    def _count(self, reason: Reason | None) -> None:
        if reason is not None:
            self.rejected[reason.value] += 1


def _microseconds(time_s: float) -> int:
    if not isfinite(time_s):
        raise InputError(f"time_s {time_s}: must be a number of seconds")
    return round(MICROSECONDS * time_s)


def _vector(name: str, given: ArrayLike) -> Vec3:
    """Three numbers, not necessarily finite."""
    values: Any = given.tolist() if isinstance(given, np.ndarray) else given
    try:
        x, y, z = values
        return (float(x), float(y), float(z))
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be three numbers, not {given!r:.60}") from None


def _matrix(name: str, given: ArrayLike, rows: int | None = None) -> Floats:
    """(N, 3) numbers."""
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be an array of numbers") from None
    if values.ndim != 2 or values.shape[1] != 3 or rows not in (None, len(values)):
        wanted = "N" if rows is None else rows
        raise InputError(f"{name}: must have the shape ({wanted}, 3), not {values.shape}")
    return values


def _times(given: ArrayLike, rows: int) -> list[float]:
    values = np.asarray(given, dtype=float)
    if values.shape != (rows,):
        raise InputError(f"time_s: must have the shape ({rows},), not {values.shape}")
    times: list[float] = values.tolist()
    return times


def _tuples(matrix: Floats) -> list[Vec3]:
    return [(x, y, z) for x, y, z in matrix.tolist()]


def _reports(given: ArrayLike | None, rows: int) -> Sequence[Vec3 | None]:
    """A velocity for each row, None where its horizontal part is not known."""
    if given is None:
        return [None] * rows
    return [
        velocity if isfinite(velocity[0]) and isfinite(velocity[1]) else None
        for velocity in _tuples(_matrix("velocity_ned_m_s", given, rows))
    ]
