"""One vehicle's estimator: samples in, attitude out. No I/O and no clock."""

from typing import Any

import numpy as np

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.search import UNKNOWN_RAD
from estimator.arrays import Floats
from estimator.filter.types import gain_in_words
from estimator.geometry.earth import PlaceField
from estimator.live.aiding_span import with_imu_lag
from estimator.live.compass_check import dip_error_rad
from estimator.live.core import Snapshot, apply_turn, change_imu
from estimator.live.kernel_handle import NO_ROWS_BOUND
from estimator.live.published import write
from estimator.live.rows import NO_REPORT_ROWS, NORTHS, Q, Rows
from estimator.live.settings import Settings
from estimator.live.state import State
from estimator.live.step import AIDED, SHOWN_LATE, TAKEN
from estimator.live.taking import decide, set_position, take_rate, take_report, take_sample
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import (
    Attitude,
    ImuSample,
    Quaternion,
    RateSample,
    Vec3,
    VehicleClass,
)

# In place of a sample, where rows of them are bound.
NO_SAMPLE_ITSELF = (0, *(0.0,) * 9, False)

_new: Any = tuple.__new__


class Estimator:
    """The filter of a profile, fed sample by sample.

    All that changes is one :class:`~estimator.live.state.State`.
    """

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        self._state = State(profile, fixed_gain)

    @property
    def profile(self) -> Profile:
        """The parameters in use."""
        return self._state.profile

    @property
    def snapshot(self) -> Snapshot:
        """The whole state. Set it to resume from it."""
        return self._state.snapshot

    @snapshot.setter
    def snapshot(self, snapshot: Snapshot) -> None:
        self._state.resume(snapshot)

    def replace_profile(self, profile: Profile) -> None:
        """Use other parameters from the next sample on; the estimate stays.

        All or nothing: what a profile raises, it raises before anything has changed.
        """
        self._state.replace_profile(profile)

    def restart(self) -> None:
        """Forget the attitude and align anew, as after the vehicle's reboot."""
        self._state.restart()

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude yet."""
        return self._state.context.phase is not Phase.EMPTY

    @property
    def settings(self) -> Settings:
        """What the profile comes to for this vehicle and place."""
        return self._state.settings

    @property
    def is_aided(self) -> bool:
        """Whether velocity helps."""
        return self._state.context.phase is Phase.AIDED

    @property
    def unshown_iron_rad(self) -> float:
        """How far iron may turn a heading by the field, for an uncalibrated compass."""
        return self._state.unshown_iron_rad

    @property
    def fixed_gain(self) -> float | None:
        """K, if it is not the profile's rules that set it."""
        return self._state.fixed_gain

    def update(self, sample: ImuSample) -> Reason | None:
        """Take one sample; None, or the reason why it was refused."""
        return self.take(*sample)

    def take(
        self, time_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3, mag_gauss: Vec3, has_mag: bool
    ) -> Reason | None:
        """Take the fields of an :class:`ImuSample`, as :meth:`update` does: it is one call less."""
        state = self._state
        if not state.takes_rows:
            return take_sample(state, ImuSample(time_us, gyr_rad_s, acc_m_s2, mag_gauss, has_mag))
        core = state.core if state.is_ready else state.ready()
        _, _, end, state.published = core.advance(
            time_us, *gyr_rad_s, *acc_m_s2, *mag_gauss, has_mag, 0, 0, 0
        )
        return None if end == TAKEN else decide(state, end)

    def update_rows(
        self,
        rows: Rows,
        published: Floats,
        report_rows: Floats = NO_REPORT_ROWS,
        taken: int = 0,
        next_report: int = 0,
    ) -> tuple[int, int]:
        """Take rows from ``taken``, and ``report_rows`` (M, REPORT_SIZE) from ``next_report`` on.

        ``published`` (N, columns as in :mod:`estimator.live.rows`) gets each row's attitude.
        Returns the first row and the first report that were not taken: a row for :meth:`take`, or
        N. It also stops behind a row whose attitude is not finite.
        """
        state, n, bound = self._state, len(published), None
        while taken < n and state.takes_rows:
            core = state.ready()
            if core is not bound:
                core.bind_rows(rows, published, report_rows)
                bound = core
            taken, next_report, end, _ = core.advance(*NO_SAMPLE_ITSELF, taken, n, next_report)
            state.published = None
            if decide(state, end) is not None:
                break
            if end not in (TAKEN, SHOWN_LATE):  # what was decided has changed the attitude
                write(
                    published[taken - 1], state.ready().publish(state.core.time_us), self.is_aided
                )
                if not np.isfinite(published[taken - 1, Q]).all():
                    break
        if state.core is bound:
            bound.bind_rows(*NO_ROWS_BOUND)
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
        if isinstance(report, RateSample):
            return take_rate(self._state, report)
        return take_report(self._state, report)

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
    ) -> bool:
        """Where and when it is: from magnetic to true north, if the profile leaves that open.

        A heading from magnetic north turns with the declination, so nothing has to be corrected. At
        another place the field is another one, and conclusions from the former field are withdrawn.
        Returns whether the position was news.
        """
        return set_position(self._state, latitude_deg, longitude_deg, altitude_m, unix_us)

    def set_field_calibrated(self, calibrated: bool) -> None:
        """Declare whether the compass is calibrated.

        If it is not, or without a declaration, a heading by the field has a sigma of 45 deg until
        turns have shown its iron, or velocity the heading.
        """
        state, before = self._state, self._state.context.compass
        state.change_context(compass=compass.declare(before, calibrated))
        if compass.is_usable(before, state.core.time_us) and not calibrated:
            state.enter(Cause.MISLED)

    def set_imu_lag(self, gyr_s: float, acc_s: float) -> None:
        """How old gyroscope's and accelerometer's samples are when sent, mostly by low-passes (s).

        The default is that of most vehicles, ``imu_lag_s`` of the profile.
        """
        state, lead_s = self._state, gyr_s - acc_s
        state.change_context(imu_lag_s=gyr_s, acc_lead_s=lead_s)
        if self.is_aided:
            state.set_core(with_imu_lag(state.core.core, gyr_s, lead_s))

    def set_vehicle_class(self, vehicle_class: VehicleClass) -> None:
        """What carries the IMU, which shows how it accelerates, and whether it slips sideways.

        It switches on ``conditioning.in_vehicle``, and sets ``aiding.sideslip_rad`` if that has its
        default.
        """
        state = self._state
        if vehicle_class is not state.context.vehicle_class:
            state.change_context(vehicle_class=vehicle_class)
            state.replace_profile(state.profile)

    def change_imu(self) -> None:
        """The samples are another IMU's from now on: its biases are its own."""
        state = self._state
        state.set_core(change_imu(state.settings, state.core.core, is_aided=self.is_aided))

    def turn(self, turn_ned: Quaternion) -> None:
        """Turn the whole state by a rotation in NED that no sensor has felt, to test recovery."""
        state = self._state
        state.set_core(apply_turn(state.core.core, turn_ned, is_aided=self.is_aided))

    def attitude(self, time_us: int) -> Attitude:
        """The attitude at ``time_us``, propagated from the last sample for output only."""
        state = self._state
        published = state.published
        if published is None or published[0] != time_us:
            published = state.ready().publish(time_us)
        # in the order of its fields; an Attitude's own constructor takes three times as long
        attitude: Attitude = _new(Attitude, (*published[:-1], NORTHS[published[-1]]))
        return attitude

    @property
    def compass_fault(self) -> str:
        """Why the heading comes from velocity and not from the field; empty if it does not."""
        state = self._state
        if compass.is_contradicted(state.context.compass, state.core.time_us):
            return compass.CONTRADICTED
        if state.source == AIDED or not state.settings.conditioned or not self.aligned:
            return ""
        time_us = state.core.time_us
        if self.attitude(time_us).sigma_heading_rad < UNKNOWN_RAD:  # turns have shown the iron
            return ""
        return compass.evidence_against(state.context.compass, time_us)

    @property
    def compass_off_rad(self) -> float:
        """The angle (rad, about down) by which a compass is turned that velocity contradicts."""
        return self._state.context.compass.turned_rad

    @property
    def dip_error_rad(self) -> float:
        """How far the field, as read, contradicts the vertical of accelerometer and velocity.

        0 where it does not, and without velocity.
        """
        state = self._state
        return dip_error_rad(state.settings, state.core.core) if self.is_aided else 0.0

    @property
    def rates(self) -> str:
        """Whose rates the turning was integrated through: "imu", or "imu+attitude"."""
        return "imu+attitude" if self._state.core.integrated_steps else "imu"

    @property
    def gain_in_words(self) -> str:
        """What sets the gain K, and what that is worth."""
        settings = self._state.settings
        return gain_in_words(settings.filter, conditioned=settings.conditioned)

    @property
    def contradicted_axes(self) -> tuple[bool, bool, bool]:
        """Whether field and force contradict the gyroscope's axes x, y, z, or others stand in."""
        return self._state.core.contradicted_axes

    @property
    def place_field(self) -> PlaceField | None:
        """The Earth's field where the vehicle is, None without a position."""
        return self._state.place_field
