"""The estimator as programs use it: readings as arrays, one sample a call or all at once."""

import warnings
from collections import Counter
from copy import copy
from functools import partial
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.samples.imu_stream import MAG_LIMIT_GAUSS, RepeatedField, is_field
from estimator import estimator
from estimator.compilation.kernel_folder import notify_programs
from estimator.errors import InputError
from estimator.live.core import Snapshot
from estimator.live.rows import (
    NO_REPORT_ROWS,
    NORTH,
    OUTPUT_SIZE,
    Rows,
    cut,
    reports_between,
    rows_of,
)
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, Attitude, Floats, ImuSample, Vec3, VelocitySample
from fuzzbee import arguments
from fuzzbee.arguments import MICROSECONDS, MOST_S, array, microseconds, number, vector
from fuzzbee.attitudes import Attitudes, attitudes_of_rows
from fuzzbee.fit import advice, is_enough

notify_programs()


class Unfit(UserWarning):
    """Readings that would fit each other better in another unit or in other axes."""


class EstimatorState(NamedTuple):
    """What an :class:`Estimator` has become, as a value."""

    snapshot: Snapshot
    number: int  # of the next sample
    last_us: int  # the time of the last one
    field: tuple[Vec3, int]  # the last one that was new, and its time
    rejected: dict[str, int]
    is_checked: bool  # whether units and axes have been compared


class Estimator:
    """One vehicle's attitude from its gyroscope, accelerometer and, if there is one, magnetometer.

    Body axes are forward, right, down (FRD), the inertial ones north, east, down (NED). The
    accelerometer gives the specific force: (0, 0, -9.8) m/s^2 where the vehicle stands level.
    The magnetometer's unit is the gauss (1 uT is 0.01 gauss). ``rejected`` counts the samples and
    reports that were refused, by reason.

    Args:
        profile: what ``load_profile`` gives, or the name or file it would be given.
        rate_hz: samples a second, 1e-6 to 1e6, for data whose samples have no times of their own.
        gain: fixes K, the gain that otherwise the profile's rules set.
        compass_calibrated: whether the magnetometer has been calibrated. If that is not known its
            heading has a sigma of 45 deg until turns have shown its iron, or velocity the heading.

    Raises:
        InputError: an unusable profile, rate or gain.
    """

    def __init__(
        self,
        profile: Profile | str = "imu",
        rate_hz: float | None = None,
        *,
        gain: float | None = None,
        compass_calibrated: bool | None = None,
    ) -> None:
        if rate_hz is not None:
            rate_hz = number("rate_hz", rate_hz, 1.0 / MICROSECONDS, MICROSECONDS, " a second")
        self.profile = arguments.profile_of(profile)
        self._is_plain = self.profile.has_plain_imu
        self._rate_hz = rate_hz
        gain = None if gain is None else arguments.gain_of("gain", gain)
        self._fixed: dict[str, Any] = {"gain": gain, "compass_calibrated": compass_calibrated}
        self.reset()

    def __repr__(self) -> str:
        rate = "" if self._rate_hz is None else f" at {self._rate_hz:g} Hz"
        refused = f", {self.rejected.total()} refused" if self.rejected else ""
        return f"<fuzzbee.Estimator after {self._number} samples{rate}{refused}>"

    def reset(self) -> None:
        """Begin as if nothing had come yet; a position is forgotten, too."""
        self.rejected: Counter[str] = Counter()
        self._inner = estimator.Estimator(self.profile, self._fixed["gain"])
        if (calibrated := self._fixed["compass_calibrated"]) is not None:
            self._inner.set_field_calibrated(calibrated)
        self._number = 0  # of the next sample
        self._last_us = 0
        self._field = RepeatedField()
        self._is_checked = False

    @property
    def state(self) -> EstimatorState:
        """All that samples have changed. Set it, in an estimator made alike, to go on from there.

        It can be pickled, for another process with the same version of fuzzbee.
        """
        came = self._number, self._last_us, self._field.last
        return EstimatorState(self._inner.snapshot, *came, dict(self.rejected), self._is_checked)

    @state.setter
    def state(self, state: EstimatorState) -> None:
        if not isinstance(state, EstimatorState):
            raise InputError(f"state {state!s:.60}: must be one of an Estimator")
        snapshot, self._number, self._last_us, last_field, rejected, self._is_checked = state
        self._inner.snapshot, self._field.last = snapshot, last_field
        self.rejected = Counter(rejected)

    def copy(self) -> "Estimator":
        """Another one that goes on from here by itself."""
        return copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), self.profile, self._rate_hz, **self._fixed), (), self.state

    def __setstate__(self, state: EstimatorState) -> None:
        self.state = state

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
        gyr, acc = vector("gyr_rad_s", gyr_rad_s), vector("acc_m_s2", acc_m_s2)
        mag = ZERO_VEC3 if mag_gauss is None else vector("mag_gauss", mag_gauss)
        if time_s is None:
            time_us = round(MICROSECONDS * self._number / self._rate())
        else:
            time_us = microseconds(time_s)
        self._number += 1
        self._last_us = time_us
        has_mag = mag_gauss is not None and self._field.is_fresh(mag, time_us)
        if has_mag and not is_field(mag):
            self._count(Reason.MAGNETOMETER_OUT_OF_RANGE)
            has_mag = False
        mag = mag if has_mag else ZERO_VEC3
        if not self._is_plain:
            sample = ImuSample(time_us, gyr, acc, mag, has_mag)
            _, gyr, acc, mag, _ = self.profile.to_body_axes(sample)
        inner = self._inner
        if (reason := inner.take(time_us, gyr, acc, mag, has_mag)) is not None:
            self._count(reason)
            if not inner.aligned:  # a sample that was taken has aligned it
                return None
        attitude = inner.attitude(time_us)
        w, x, y, z = attitude.q_ned_frd
        if isfinite(w + x + y + z):
            return attitude
        self._count(Reason.ESTIMATE_NOT_FINITE)
        inner.restart()  # no later sample would repair it
        return None

    def update_velocity(
        self,
        velocity_ned_m_s: ArrayLike,
        time_s: float | None = None,
        sigma_m_s: float = arguments.VELOCITY_SIGMA_M_S,
    ) -> None:
        """Take a velocity over ground (3,), as of a satellite receiver.

        It shows acceleration from gravity and shows the heading. ``time_s`` is the time that it
        was measured at, without which it is that of the last sample; a third component of NaN
        is unknown. One that cannot be used is counted in ``rejected``.

        Raises:
            InputError: it has not three numbers, or a sigma or time that is none.
        """
        north, east, down = vector("velocity_ned_m_s", velocity_ned_m_s)
        sigma_m_s = number("sigma_m_s", sigma_m_s, 0.0)
        time_us = self._last_us if time_s is None else microseconds(time_s)
        velocity = (north, east, down if isfinite(down) else 0.0)
        report = VelocitySample(time_us, velocity, isfinite(down), sigma_m_s)
        self._count(self._inner.update_report(report))

    def update_batch(
        self,
        gyr_rad_s: ArrayLike,
        acc_m_s2: ArrayLike,
        mag_gauss: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        velocity_ned_m_s: ArrayLike | None = None,
        position: ArrayLike | None = None,
        *,
        strict: bool = False,
    ) -> Attitudes:
        """Take N samples, (N, 3) each; the attitude after each of them.

        The result is that of N calls of ``update``. Where a row of ``velocity_ned_m_s`` is known,
        ``update_velocity`` comes before it; a row of NaN is no report. A row of ``mag_gauss`` that
        is NaN is no field. ``time_s`` (N,) is needed without a rate. ``position`` (N, 4) has the
        arguments of ``set_position``, which comes before each row that is known.

        The first five seconds or more are looked at as a whole: where another unit or other axes
        would fit much better, the attitudes' ``warnings`` name it, and so does a Python warning
        (:class:`Unfit`). So do both where most samples were rejected.

        Raises:
            InputError: arrays of other shapes, or no times; ``strict``, and there are warnings.
        """
        readings = (gyr_rad_s, acc_m_s2, mag_gauss, time_s, velocity_ned_m_s, position)
        rows, reports, places, lines = self._rows_of(*readings, strict=strict)
        published = np.empty((len(rows.times_us), OUTPUT_SIZE))
        lines = self._take(rows, published, reports, places, lines)
        return attitudes_of_rows(rows.times_us, published, lines)

    def smooth(
        self,
        gyr_rad_s: ArrayLike,
        acc_m_s2: ArrayLike,
        mag_gauss: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        velocity_ned_m_s: ArrayLike | None = None,
        position: ArrayLike | None = None,
    ) -> Attitudes:
        """The attitudes of a whole recording, each by all that came before and behind it.

        Arguments are those of ``update_batch``. The estimator itself stays as it was:
        of it only profile, rate, gain and position count. ``error``, ``gain`` and the
        confidences are those of its way forward.

        Raises:
            InputError: see ``update_batch``.
        """
        from estimator.smoothing import Offered, Recorder, smooth_offered

        forward = Estimator(self.profile, self._rate_hz, **self._fixed)
        readings = (gyr_rad_s, acc_m_s2, mag_gauss, time_s, velocity_ned_m_s, position)
        rows, reports, places, lines = forward._rows_of(*readings)
        published = np.empty((len(rows.times_us), OUTPUT_SIZE))
        recorder = Recorder(self.profile, self._inner.fixed_gain, Offered(rows, published))
        recorder.snapshot = self._inner.snapshot
        recorder.restart()
        forward._inner = recorder
        lines = forward._take(rows, published, reports, places, lines)
        for places in smooth_offered(recorder, published):
            published[places, NORTH] = published[-1, NORTH]
        return attitudes_of_rows(rows.times_us, published, lines)

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_s: float
    ) -> None:
        """Where and when this is: the heading is from true north then (World Magnetic Model).

        Raises:
            InputError: no place on Earth, or no time.
        """
        self._inner.set_position(
            number("latitude_deg", latitude_deg, -90.0, 90.0),
            number("longitude_deg", longitude_deg, -360.0, 360.0),
            number("altitude_m", altitude_m),
            round(MICROSECONDS * number("unix_s", unix_s, -MOST_S, MOST_S, " of seconds")),
        )

    def _rows_of(
        self, *given: Any, strict: bool = False
    ) -> tuple[Rows, Floats, Floats, tuple[str, ...]]:
        """The arguments of ``update_batch``, checked: readings, velocities, positions, advice."""
        gyr_rad_s, acc_m_s2, mag_gauss, time_s, velocity_ned_m_s, position = given
        gyr = array("gyr_rad_s", gyr_rad_s, None, 3)
        n = len(gyr)
        acc = array("acc_m_s2", acc_m_s2, n, 3)
        mag = np.zeros((n, 3)) if mag_gauss is None else array("mag_gauss", mag_gauss, n, 3)
        places = np.zeros((0, 5)) if position is None else arguments.positions_of(position, n)
        if time_s is None:
            numbers = np.arange(self._number, self._number + n, dtype=float)
            times_us = np.rint(MICROSECONDS * numbers / self._rate()).astype(np.int64)
        else:
            times_us = arguments.times_of(time_s, n)
        reports, fast = NO_REPORT_ROWS, 0
        if velocity_ned_m_s is not None:
            velocity = array("velocity_ned_m_s", velocity_ned_m_s, n, 3)
            reports, fast = arguments.velocities_of(times_us, velocity)
        self._number += n
        self._last_us = int(times_us[-1]) if n else self._last_us
        has_mag = self._field.fresh_rows(mag, times_us)
        readings = (gyr, acc, mag)
        if not self._is_plain:
            readings = self.profile.to_body_rows(gyr, acc, np.where(has_mag[:, None], mag, 0.0))
        rows = rows_of(times_us, *readings, has_mag)
        lines: tuple[str, ...] = ()
        if strict or not self._is_checked:
            lines = advice(rows)
            self._is_checked = self._is_checked or is_enough(rows.times_us)
        if lines and strict:
            raise InputError("; ".join(lines))
        for line in lines:
            warnings.warn(line, Unfit, stacklevel=3)
        x, y, z = (np.abs(mag) > MAG_LIMIT_GAUSS).T
        too_strong = has_mag & (x | y | z)
        rows.has_mag[too_strong] = False
        self._count(Reason.MAGNETOMETER_OUT_OF_RANGE, int(too_strong.sum()))
        self._count(Reason.VELOCITY_OUT_OF_RANGE, fast)
        return rows, reports if self.profile.conditioned else NO_REPORT_ROWS, places, lines

    def _take(
        self, rows: Rows, published: Floats, reports: Floats, places: Floats, lines: tuple[str, ...]
    ) -> tuple[str, ...]:
        """Take all, with positions between rows; the warnings, one if most rows were rejected.

        ``published`` (N, :data:`OUTPUT_SIZE`) is given the attitudes.
        """
        begin, n, refused = 0, len(published), Counter[str]()
        for row, *place in (*places.tolist(), (n,)):
            end = int(row)
            between = reports_between(reports, begin, end)
            part = cut(rows, begin, end)
            reasons = self._inner.take_all(part, published[begin:end], between)
            refused.update(reason.value for reason in reasons)
            if place:
                self.set_position(*place)
            begin = end
        self.rejected += refused
        if not lines and 2 * refused.total() > n:
            most, count = refused.most_common(1)[0]
            lines = (f"most of the samples could not be used: {count} of {n} are {most}",)
            warnings.warn(lines[0], Unfit, stacklevel=3)
        return lines

    def _rate(self) -> float:
        if self._rate_hz is None:
            raise InputError("an estimator without rate_hz needs time_s with every sample")
        return self._rate_hz

    def _count(self, reason: Reason | None, times: int = 1) -> None:
        if reason is not None and times:
            self.rejected[reason.value] += times
