"""The estimator as programs use it: readings as arrays, one sample a call or all at once."""

import warnings
from collections import Counter
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.samples.imu_stream import MAG_LIMIT_GAUSS, RepeatedField, finite_or_zero, is_field
from estimator import estimator
from estimator.aiding.sources.source import SPEED_LIMIT_M_S
from estimator.arrays import Floats, Times
from estimator.compilation.notice import notify_programs
from estimator.errors import InputError
from estimator.live.core import Snapshot
from estimator.live.rows import (
    HAS_VERTICAL,
    NO_REPORT_ROWS,
    NORTH,
    OUTPUT_SIZE,
    REPORT_SIZE,
    ROW,
    SIGMA_M_S,
    TIME,
    Rows,
    X,
    Z,
    cut,
    reports_between,
    rows_of,
)
from estimator.profile import LEAST_GAIN, MOST_GAIN, Profile
from estimator.reasons import Reason
from estimator.row_taking import take
from estimator.types import ZERO_VEC3, Attitude, ImuSample, Vec3, VelocitySample
from fuzzbee.arguments import (
    MICROSECONDS,
    MOST_S,
    matrix,
    microseconds,
    microseconds_of_rows,
    number,
    profile_of,
    vector,
)
from fuzzbee.attitudes import Attitudes, attitudes_of_rows
from fuzzbee.fit import advice, is_enough

# What a satellite receiver's or an autopilot's velocity is good for if nobody says.
VELOCITY_SIGMA_M_S = 0.3
# Latitude, longitude (deg), altitude (m), Unix time (s).
MOST_PLACE = (90.0, 360.0, inf, MOST_S)
notify_programs()
NO_TIME = "an estimator without rate_hz needs time_s with every sample"


class Unfit(UserWarning):
    """Readings that would fit each other better in another unit or in other axes."""


class Batch(NamedTuple):
    """Rows of readings and of reports as :mod:`estimator.live.rows` has them, and warnings.

    ``said`` (N, :data:`OUTPUT_SIZE`) takes the attitudes. ``positions`` (K, 5) has the places that
    are known before a row: row, latitude, longitude (deg), altitude (m), Unix time (s).
    """

    rows: Rows
    told: Floats
    positions: Floats
    said: Floats
    warnings: tuple[str, ...]

    @property
    def attitudes(self) -> Attitudes:
        """What is said."""
        return attitudes_of_rows(self.rows.times_us, self.said, self.warnings)


class EstimatorState(NamedTuple):
    """What an :class:`Estimator` has become, as a value."""

    snapshot: Snapshot
    number: int  # of the next sample
    last_us: int  # the time of the last one
    field: tuple[Vec3, int]  # the last one that was new, and its time
    rejected: dict[str, int]
    is_looked_at: bool


class Estimator:
    """One vehicle's attitude from its gyroscope, accelerometer and, if there is one, magnetometer.

    Body axes are forward, right, down (FRD), the inertial ones north, east, down (NED). The
    accelerometer gives the specific force: (0, 0, -9.8) m/s^2 where the vehicle stands level.
    The magnetometer's unit is the gauss (1 uT is 0.01 gauss).

    Args:
        profile: what ``load_profile`` gives, or the name or file it would be given.
        rate_hz: samples a second, 1e-6 to 1e6, for data whose samples have no times of their own.
        gain: fixes K, the gain that otherwise the profile's rules set.
        compass_calibrated: whether somebody has calibrated the magnetometer. Without a word its
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
        if gain is not None:
            gain = number("gain", gain, LEAST_GAIN, MOST_GAIN)
        self.profile = profile_of(profile)
        self._made_with = self.profile, rate_hz, gain, compass_calibrated
        self._is_plain = self.profile.has_plain_imu
        self._rate_hz = rate_hz
        self.reset()

    def __repr__(self) -> str:
        """How far it has come."""
        rate = "" if self._rate_hz is None else f" at {self._rate_hz:g} Hz"
        refused = f", {self.rejected.total()} refused" if self.rejected else ""
        return f"<fuzzbee.Estimator after {self._number} samples{rate}{refused}>"

    def reset(self) -> None:
        """Begin as if nothing had come yet; a position is forgotten, too."""
        self.rejected: Counter[str] = Counter()  # samples and reports that were refused, by reason
        *_, gain, compass_calibrated = self._made_with
        self._inner = estimator.Estimator(self.profile, gain)
        if compass_calibrated is not None:
            self._inner.set_field_calibrated(compass_calibrated)
        self._number = 0  # of the next sample
        self._last_us = 0  # the time of the last one
        self._field = RepeatedField()
        self._is_looked_at = False  # whether units and axes fit

    @property
    def state(self) -> EstimatorState:
        """All that samples have changed. Set it, in an estimator made alike, to go on from there.

        It can be pickled, for another process with the same version of fuzzbee.
        """
        rejected = dict(self.rejected)
        times = self._number, self._last_us
        return EstimatorState(
            self._inner.snapshot, *times, self._field.last, rejected, self._is_looked_at
        )

    @state.setter
    def state(self, state: EstimatorState) -> None:
        if not isinstance(state, EstimatorState):
            raise InputError(f"state {state!s:.60}: must be one of an Estimator")
        self._inner.snapshot = state.snapshot
        self._number, self._last_us = state.number, state.last_us
        self._field.last = state.field
        self.rejected = Counter(state.rejected)
        self._is_looked_at = state.is_looked_at

    def copy(self) -> "Estimator":
        """Another one that goes on from here by itself."""
        return _resumed(*self._made_with, self.state)

    def __reduce__(self) -> tuple[Any, ...]:
        return _resumed, (*self._made_with, self.state)

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
        time_us = self._next_us(time_s)
        mag = finite_or_zero(mag)
        has_mag = self._field.is_fresh(mag, time_us)
        if has_mag and not is_field(mag):
            self._count(Reason.MAGNETOMETER_OUT_OF_RANGE)
            has_mag = False
        mag = mag if has_mag else ZERO_VEC3
        if self._is_plain:
            return self._take(time_us, gyr, acc, mag, has_mag)
        sample = ImuSample(time_us, gyr, acc, mag, has_mag)
        return self._take(*self.profile.to_body_axes(sample))

    def update_velocity(
        self,
        velocity_ned_m_s: ArrayLike,
        time_s: float | None = None,
        sigma_m_s: float = VELOCITY_SIGMA_M_S,
    ) -> None:
        """Take a velocity over ground (3,), by a receiver or whoever knows it.

        It shows acceleration from gravity and shows the heading. ``time_s`` is the time that it
        was measured at, without which it is that of the last sample; a third component of NaN
        is unknown. One that cannot be used is counted in ``rejected``.

        Raises:
            InputError: it has not three numbers, or a sigma or time that is none.
        """
        north, east, down = vector("velocity_ned_m_s", velocity_ned_m_s)
        sigma_m_s = number("sigma_m_s", sigma_m_s, 0.0)
        time_us = self._last_us if time_s is None else microseconds(time_s)
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
        would fit much better, the attitudes' ``warnings`` say which, and so does a Python warning
        (:class:`Unfit`). So do both where most samples were rejected.

        Raises:
            InputError: arrays of other shapes, or no times; ``strict``, and there are warnings.
        """
        readings = (gyr_rad_s, acc_m_s2, mag_gauss, time_s, velocity_ned_m_s, position)
        return self._taken(self._batch(*readings, strict=strict)).attitudes

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

        Arguments are those of ``update_batch``. The estimator itself goes on as if nobody had
        asked: of it only profile, rate, gain and position count. ``error``, ``gain`` and the
        confidences are those of its way forward.

        Raises:
            InputError: see ``update_batch``.
        """
        from estimator.smoothing import Offered, Recorder, smooth_offered

        profile, rate_hz, gain, calibrated = self._made_with
        forward = Estimator(profile, rate_hz, gain=gain, compass_calibrated=calibrated)
        readings = (gyr_rad_s, acc_m_s2, mag_gauss, time_s, velocity_ned_m_s, position)
        batch = forward._batch(*readings)
        recorder = Recorder(profile, gain, Offered(batch.rows, batch.said))
        recorder.snapshot = self._inner.snapshot
        recorder.restart()
        forward._inner = recorder
        batch = forward._taken(batch)
        for places in smooth_offered(recorder, batch.said):
            batch.said[places, NORTH] = batch.said[-1, NORTH]
        return batch.attitudes

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

    def _take(
        self, time_us: int, gyr: Vec3, acc: Vec3, mag: Vec3, has_mag: bool
    ) -> Attitude | None:
        """One sample in body axes; the attitude after it, if there is any yet."""
        inner = self._inner
        self._count(inner.take(time_us, gyr, acc, mag, has_mag))
        if not inner.aligned:
            return None
        attitude = inner.attitude(time_us)
        w, x, y, z = attitude.q_ned_frd
        if isfinite(w + x + y + z):
            return attitude
        self._count(Reason.ESTIMATE_NOT_FINITE)
        inner.restart()  # no later sample would repair it
        return None

    def _look(self, rows: Rows, *, strict: bool) -> tuple[str, ...]:
        """What :mod:`fuzzbee.fit` says of the first rows that are enough, and of all if strict."""
        if self._is_looked_at and not strict:
            return ()
        found = advice(rows)
        self._is_looked_at = self._is_looked_at or is_enough(rows.times_us)
        if found and strict:
            raise InputError("; ".join(found))
        for line in found:
            warnings.warn(line, Unfit, stacklevel=4)
        return found

    def _batch(
        self,
        gyr_rad_s: ArrayLike,
        acc_m_s2: ArrayLike,
        mag_gauss: ArrayLike | None,
        time_s: ArrayLike | None,
        velocity_ned_m_s: ArrayLike | None,
        position: ArrayLike | None,
        *,
        strict: bool = False,
    ) -> Batch:
        """The arguments of ``update_batch`` as rows, and what :meth:`_look` says of them."""
        gyr = matrix("gyr_rad_s", gyr_rad_s)
        n = len(gyr)
        acc = matrix("acc_m_s2", acc_m_s2, n)
        mag = np.zeros((n, 3)) if mag_gauss is None else matrix("mag_gauss", mag_gauss, n)
        velocity = velocity_ned_m_s
        velocity = None if velocity is None else matrix("velocity_ned_m_s", velocity, n)
        positions = np.zeros((0, 5))
        if position is not None:
            places = matrix("position", position, n, 4)
            known = np.flatnonzero(np.isfinite(places).all(axis=1))
            positions = np.column_stack((known, places[known]))
            wrong = places[known][(np.abs(places[known]) > MOST_PLACE).any(axis=1)]
            if len(wrong):
                raise InputError(f"position {wrong[0].tolist()}: no place on Earth, or no time")
        times_us = self._next_times_us(time_s, n)
        has_mag = self._field.fresh_rows(mag, times_us)
        is_field = np.abs(mag).max(axis=1, initial=0.0) <= MAG_LIMIT_GAUSS
        readings = (gyr, acc, mag)
        if not self._is_plain:
            mag = np.where(has_mag[:, None], mag, 0.0)
            readings = self.profile.to_body_rows(gyr, acc, mag)
        rows = rows_of(times_us, *readings, has_mag)
        lines = self._look(rows, strict=strict)
        if not is_field[has_mag].all():
            self.rejected[Reason.MAGNETOMETER_OUT_OF_RANGE] += int((has_mag & ~is_field).sum())
            rows.has_mag[:] &= is_field
        told = NO_REPORT_ROWS if velocity is None else self._velocities(times_us, velocity)
        return Batch(rows, told, positions, np.empty((n, OUTPUT_SIZE)), lines)

    def _velocities(self, times_us: Times, velocity: Floats) -> Floats:
        """The rows (N, 3) of velocity that are known, as reports (M, REPORT_SIZE)."""
        known = np.flatnonzero(np.isfinite(velocity[:, :2]).all(axis=1))
        told = np.zeros((len(known), REPORT_SIZE))
        told[:, ROW], told[:, TIME] = known, times_us[known]
        told[:, X : Z + 1], told[:, SIGMA_M_S] = velocity[known], VELOCITY_SIGMA_M_S
        told[:, HAS_VERTICAL] = np.isfinite(told[:, Z])
        told[told[:, HAS_VERTICAL] == 0.0, Z] = 0.0
        is_fast = np.abs(told[:, X : Z + 1]).max(axis=1, initial=0.0) > SPEED_LIMIT_M_S
        if is_fast.any():
            self.rejected[Reason.VELOCITY_OUT_OF_RANGE] += int(is_fast.sum())
        return told[~is_fast] if self.profile.conditioned else NO_REPORT_ROWS

    def _taken(self, batch: Batch) -> Batch:
        """The batch behind its way through the estimator, with a warning if most was rejected."""
        before, n = self.rejected.copy(), len(batch.said)
        self._take_rows(batch)
        refused = self.rejected - before
        if batch.warnings or 2 * refused.total() <= n:
            return batch
        most, count = refused.most_common(1)[0]
        line = f"most of the samples could not be used: {count} of {n} are {most}"
        warnings.warn(line, Unfit, stacklevel=3)
        return batch._replace(warnings=(line,))

    def _take_rows(self, batch: Batch) -> None:
        """All rows; where somebody has said where the vehicle is, that comes between."""
        rows, told, positions, said, _ = batch
        begin = 0
        for row, *position in (*positions.tolist(), (len(said),)):
            end = int(row)
            refused = take(
                self._inner,
                cut(rows, begin, end),
                said[begin:end],
                reports_between(told, begin, end),
            )
            self.rejected.update(reason.value for reason in refused)
            if position:
                self.set_position(*position)
            begin = end

    def _next_us(self, time_s: float | None) -> int:
        """The time of the next sample, given or by its number."""
        if time_s is not None:
            self._last_us = microseconds(time_s)
        elif self._rate_hz is None:
            raise InputError(NO_TIME)
        else:
            self._last_us = round(MICROSECONDS * self._number / self._rate_hz)
        self._number += 1
        return self._last_us

    def _next_times_us(self, time_s: ArrayLike | None, n: int) -> Times:
        """The times (N,) of the next ``n`` samples, given or by their numbers."""
        if time_s is not None:
            times_us = microseconds_of_rows(time_s, n)
        elif self._rate_hz is None:
            raise InputError(NO_TIME)
        else:
            numbers = np.arange(self._number, self._number + n, dtype=float)
            numbers *= MICROSECONDS
            numbers /= self._rate_hz
            times_us = np.rint(numbers, out=numbers).astype(np.int64)
        self._number += n
        self._last_us = int(times_us[-1]) if n else self._last_us
        return times_us

    def _count(self, reason: Reason | None) -> None:
        if reason is not None:
            self.rejected[reason.value] += 1


def _resumed(
    profile: Profile,
    rate_hz: float | None,
    gain: float | None,
    compass_calibrated: bool | None,
    state: EstimatorState,
) -> Estimator:
    """What pickle and copy make of an estimator."""
    made = Estimator(profile, rate_hz, gain=gain, compass_calibrated=compass_calibrated)
    made.state = state
    return made
