"""One vehicle's estimator: samples in, attitude out. No I/O and no clock."""

from math import nan
from typing import Any

import numpy as np

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.search import UNKNOWN_RAD
from estimator.filter.types import gain_in_words
from estimator.geometry.earth import update_position
from estimator.live.aiding_span import with_imu_lag
from estimator.live.compass_check import dip_error_rad
from estimator.live.core import apply_turn, change_imu, initial_core
from estimator.live.kernel_handle import NO_ROWS_BOUND, bind_rows, status
from estimator.live.published import write
from estimator.live.rows import (
    NO_REPORT_ROWS,
    NORTH,
    NORTHS,
    Q,
    Rows,
    is_due,
    report_of,
    require_writable,
    rows_of,
)
from estimator.live.situation import AIDED
from estimator.live.state import State
from estimator.live.step import SHOWN_LATE, TAKEN
from estimator.live.taking import decide, move, take_rate, take_report, take_sample
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import (
    ZERO_VEC3,
    Attitude,
    Floats,
    ImuSample,
    Quaternion,
    RateSample,
    Vec3,
    VehicleClass,
)

# In place of a sample, where rows of them are bound.
NO_SAMPLE_ITSELF = (0, *(0.0,) * 9, False)

_new: Any = tuple.__new__


class Estimator(State):
    """The filter of a profile, fed sample by sample: what can be done to its state, and read."""

    def update(self, sample: ImuSample) -> Reason | None:
        """Take one sample; None, or the reason why it was refused."""
        return self.take(*sample)

    def take(
        self, time_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3, mag_gauss: Vec3, has_mag: bool
    ) -> Reason | None:
        """Take the fields of an :class:`ImuSample`, as :meth:`update` does: it is one call less."""
        if not self.takes_rows:
            return take_sample(self, ImuSample(time_us, gyr_rad_s, acc_m_s2, mag_gauss, has_mag))
        advance = self.advance if self.is_ready else self.ready()
        _, _, end, self.published = advance(
            time_us, *gyr_rad_s, *acc_m_s2, *mag_gauss, has_mag, 0, 0, 0
        )
        return None if end == TAKEN else decide(self, end)

    def take_all(
        self, rows: Rows, published: Floats, report_rows: Floats = NO_REPORT_ROWS
    ) -> list[Reason]:
        """Take all rows and the reports before them; why something was refused.

        ``published`` (N, OUTPUT_SIZE) gets the attitude after each row, NaN where there is none. An
        estimator whose attitude is not finite begins anew.
        """
        refused: list[Reason | None] = []
        taken, next_report, n = 0, 0, len(published)
        while taken < n:
            begin = taken
            taken, next_report = self.update_rows(rows, published, report_rows, taken, next_report)
            if taken > begin and not np.isfinite(published[taken - 1, Q]).all():
                refused.append(self._begin_anew(published[taken - 1]))
            if taken < n:
                while is_due(report_rows, next_report, taken):
                    refused.append(self.update_report(report_of(report_rows[next_report])))
                    next_report += 1
                time_us, gyr, acc, mag, has_mag = (column[taken].tolist() for column in rows)
                field = tuple(mag) if has_mag else ZERO_VEC3
                refused.append(self.take(time_us, tuple(gyr), tuple(acc), field, has_mag))
                refused.append(self.put(time_us, published[taken]))
                taken += 1
        return [reason for reason in refused if reason is not None]

    def put(self, time_us: int, row: Floats) -> Reason | None:
        """The attitude into a row, NaN if there is none; the reason if it has been lost."""
        row[:], row[NORTH] = nan, 0.0
        if not self.aligned:
            return None
        write(row, self.published_at(time_us), self.is_aided)
        return None if np.isfinite(row[Q]).all() else self._begin_anew(row)

    def _begin_anew(self, row: Floats) -> Reason:
        """Restart after an attitude that is not finite: no later sample would repair it."""
        row[:], row[NORTH] = nan, 0.0
        self.restart()
        return Reason.ESTIMATE_NOT_FINITE

    def update_rows(
        self,
        rows: Rows,
        published: Floats,
        report_rows: Floats = NO_REPORT_ROWS,
        taken: int = 0,
        next_report: int = 0,
    ) -> tuple[int, int]:
        """Take rows from ``taken``, and ``report_rows`` (M, REPORT_SIZE) from ``next_report`` on.

        Compiled code takes rows up to one that needs a decision first. ``published``
        (N, OUTPUT_SIZE) gets each row's attitude.
        Returns the first row and the first report that were not taken: a row for :meth:`take`, or
        N. It also stops behind a row whose attitude is not finite.
        """
        rows, n, bound = rows_of(*rows), len(rows.times_us), None
        require_writable(published, n)
        while taken < n and self.takes_rows:
            advance = self.ready()
            if self.handle is not bound:
                self.run(bind_rows, rows, published, report_rows)
                bound = self.handle
            taken, next_report, end, _ = advance(*NO_SAMPLE_ITSELF, taken, n, next_report)
            self.published = None
            if decide(self, end) is not None:
                break
            if end not in (TAKEN, SHOWN_LATE):  # what was decided has changed the attitude
                write(published[taken - 1], self.published_at(self.time_us), self.is_aided)
                if not np.isfinite(published[taken - 1, Q]).all():
                    break
        if bound is not None and self.handle is bound:
            self.run(bind_rows, *NO_ROWS_BOUND)
        return taken, next_report

    def update_report(self, report: Any) -> Reason | None:
        """Take a report of something beside the IMU; None, or why it was refused.

        A report of a source of aiding (:mod:`estimator.aiding.sources.source`), such as a
        :class:`VelocitySample`, waits for the sample that reaches its time. Others than velocity
        count only while velocity helps. Raw vectors use none. A :class:`RateSample` shows the
        turning between the IMU samples around it, if it agrees with those.

        Raises:
            InputError: no source makes reports of this type, or one of its fields is no number.
        """
        return (take_rate if isinstance(report, RateSample) else take_report)(self, report)

    def replace_profile(self, profile: Profile) -> None:
        """Use other parameters from the next sample on; the estimate stays.

        All or nothing: what a profile raises, it raises before anything has changed.
        """
        self.use_profile(profile)

    def restart(self) -> None:
        """Forget the attitude and align anew; what was declared, and the place, stay."""
        known = compass.restart(self.context.compass)
        self.change_context(phase=Phase.EMPTY, reports=(), is_by_field=False, compass=known)
        self.set_core(initial_core(self.settings))

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
    ) -> bool:
        """Where and when it is: from magnetic to true north, if the profile leaves that open.

        A heading from magnetic north turns with the declination, so nothing has to be corrected. At
        another place the field is another one, and conclusions from the former field are withdrawn.
        Returns whether the position was news.
        """
        if not self.settings.learns_north:
            return False
        before = self.context.last_position
        known = update_position(before, latitude_deg, longitude_deg, altitude_m, unix_us)
        if known is not before:
            move(self, known)
        return known is not before

    def set_field_calibrated(self, calibrated: bool) -> None:
        """Declare whether the compass is calibrated.

        If it is not, or without a declaration, a heading by the field has a sigma of 45 deg until
        turns have shown its iron, or velocity the heading.
        """
        before = self.context.compass
        self.change_context(compass=compass.declare(before, calibrated))
        if compass.is_usable(before, self.time_us) and not calibrated:
            self.enter(Cause.MISLED)

    def set_imu_lag(self, gyr_s: float, acc_s: float) -> None:
        """How old gyroscope's and accelerometer's samples are when sent, mostly by low-passes (s).

        The default is that of most vehicles, ``imu_lag_s`` of the profile.
        """
        lead_s = gyr_s - acc_s
        self.change_context(imu_lag_s=gyr_s, acc_lead_s=lead_s)
        if self.is_aided:
            self.set_core(with_imu_lag(self.core, gyr_s, lead_s))

    def set_vehicle_class(self, vehicle_class: VehicleClass) -> None:
        """What carries the IMU, which shows how it accelerates, and whether it slips sideways.

        It switches on ``conditioning.in_vehicle``, and sets ``aiding.sideslip_rad`` if that has its
        default.
        """
        if vehicle_class is not self.context.vehicle_class:
            self.change_context(vehicle_class=vehicle_class)
            self.use_profile(self.profile)

    def change_imu(self) -> None:
        """The samples are another IMU's from now on: its biases are its own."""
        self.set_core(change_imu(self.settings, self.core, is_aided=self.is_aided))

    def turn(self, turn_ned: Quaternion) -> None:
        """Turn the whole state by a rotation in NED that no sensor has felt, to test recovery."""
        self.set_core(apply_turn(self.core, turn_ned, is_aided=self.is_aided))

    def attitude(self, time_us: int) -> Attitude:
        """The attitude at ``time_us``, propagated from the last sample for output only."""
        published = self.published_at(time_us)
        # in the order of its fields; an Attitude's own constructor takes three times as long
        attitude: Attitude = _new(Attitude, (*published[:-1], NORTHS[published[-1]]))
        return attitude

    @property
    def compass_fault(self) -> str:
        """Why the heading comes from velocity and not from the field; empty if it does not."""
        known, time_us = self.context.compass, self.time_us
        if compass.is_contradicted(known, time_us):
            return compass.CONTRADICTED
        if self.source == AIDED or not self.settings.conditioned or not self.aligned:
            return ""
        if self.attitude(time_us).sigma_heading_rad < UNKNOWN_RAD:  # turns have shown the iron
            return ""
        return compass.evidence_against(known, time_us)

    @property
    def compass_off_rad(self) -> float:
        """The angle (rad, about down) by which a compass is turned that velocity contradicts."""
        return self.context.compass.turned_rad

    @property
    def dip_error_rad(self) -> float:
        """How far the field, as read, contradicts the vertical of accelerometer and velocity.

        0 where it does not, and without velocity.
        """
        return dip_error_rad(self.settings, self.core) if self.is_aided else 0.0

    @property
    def rates(self) -> str:
        """Whose rates the turning was integrated through: "imu", or "imu+attitude"."""
        _, integrated_steps, *_ = self.run(status)
        return "imu+attitude" if integrated_steps else "imu"

    @property
    def gain_in_words(self) -> str:
        """What sets the gain K, and what that is worth."""
        return gain_in_words(self.settings.filter, conditioned=self.settings.conditioned)

    @property
    def contradicted_axes(self) -> tuple[bool, bool, bool]:
        """Whether field and force contradict the gyroscope's axes x, y, z, or others stand in."""
        *_, (a, b, c), (x, y, z) = self.run(status)
        return x or a, y or b, z or c
