"""One vehicle's estimator: samples in, attitude out. No I/O and no clock."""

from math import radians
from typing import Any

from estimator.aiding import Report, compass
from estimator.aiding.compass import Compass
from estimator.aiding.place import Whereabouts, resembles, said, unlike
from estimator.aiding.search import EMPTY_SEARCH
from estimator.compilation.compiled import plain
from estimator.conditioning.condition import condition
from estimator.conditioning.condition import initial_state as initial_conditioning
from estimator.conditioning.types import Conditioned, ConditioningState
from estimator.filter import kernel
from estimator.filter.alignment import align
from estimator.filter.observation import raw_vectors
from estimator.filter.types import initial_state
from estimator.geometry.quaternion import exp, multiply, subtract
from estimator.live.aiding_start import Start, begin_aiding, start_by_field, start_by_velocity
from estimator.live.conditioned import conditioned_vectors
from estimator.live.reports import NO_REPORT, enqueue, refusal_of_report, take_due
from estimator.live.resident import (
    advance,
    advance_aided,
    contents_of,
    hear_inside,
    published_inside,
    resident,
    search_inside,
)
from estimator.live.settings import settings_of
from estimator.live.snapshot import Snapshot, apply_turn, change_imu, contents_for, flat, published
from estimator.profile import Profile
from estimator.refusal import refusal, report_in_floats, sample_in_floats
from estimator.types import (
    ZERO_VEC3,
    Attitude,
    ImuSample,
    Quaternion,
    VelocitySample,
)

# The output is propagated this far beyond the last sample at most, s; then the
# last rate says nothing about the vehicle any more.
OUTPUT_HORIZON_S = 1.0
# The heading by a compass that is not calibrated.
UNCALIBRATED_SIGMA_RAD = radians(45.0)
# Time over which e is averaged for the sigma of raw vectors.
SIGMA_TIME_S = 1.0


class Estimator:
    """The filter of a profile, fed sample by sample.

    While conditioned samples come, the state lives in compiled memory
    (:mod:`estimator.live.resident`) and ``_snapshot`` holds only times and reports.
    """

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        self._fixed_gain = fixed_gain
        self._declination_rad: float | None = None
        self._whereabouts = Whereabouts()
        self.profile = profile
        self._settings = settings_of(profile, fixed_gain)
        self._snapshot: Snapshot
        self._inside: Any = None
        self._gyr_rad_s = ZERO_VEC3
        self._is_aided = False
        self._has_heading = False
        self._forget(Compass())

    @property
    def snapshot(self) -> Snapshot:
        """The whole state. Set it to resume from it."""
        if self._inside is not None:
            inside = contents_of(self._inside)
            self._snapshot = self._snapshot._replace(
                filter=inside.filter,
                conditioning=inside.memory,
                seen=inside.seen,
                rate_rad_s=subtract(self._gyr_rad_s, inside.filter.gyr_bias_rad_s),
                smooth_error=inside.filter.error,
                aided=inside.aided if self._is_aided else None,
                aided_covariance=flat(inside.covariance) if self._is_aided else (),
                search=inside.search,
            )
        return self._snapshot

    @snapshot.setter
    def snapshot(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot
        self._inside = None
        self._gyr_rad_s = snapshot.conditioning.previous_gyr_rad_s
        self._is_aided = snapshot.aided is not None
        self._has_heading = snapshot.seen is not None and snapshot.seen.magnetic_weight > 0.0

    def _go_inside(self, seen: Conditioned) -> None:
        """Move the state into compiled memory."""
        self._inside = resident(contents_for(self._settings, self._snapshot, seen))
        self._has_heading = seen.magnetic_weight > 0.0

    def replace_profile(self, profile: Profile) -> None:
        """Use other parameters from the next sample on; the estimate stays.

        All or nothing: what a profile raises, it raises before anything has changed.
        """
        settings = settings_of(profile, self._fixed_gain, self._declination_rad)
        derived = initial_conditioning(settings.conditioning).coefficients
        now = self.snapshot
        self.profile, self._settings = profile, settings
        # what the memory has derived from the other parameters
        conditioning = now.conditioning._replace(coefficients=derived)
        self.snapshot = now._replace(conditioning=conditioning)

    def restart(self) -> None:
        """Forget the attitude and align anew, as after the vehicle's reboot."""
        self._forget(compass.restart(self._snapshot.compass))

    def _forget(self, known: Compass) -> None:
        memory = initial_conditioning(self._settings.conditioning)
        fresh = Snapshot(initial_state(), memory, None, 0, ZERO_VEC3, False, 0.0)
        self.snapshot = fresh._replace(compass=known)

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude yet."""
        return self._snapshot.aligned

    def update(self, sample: ImuSample) -> str | None:
        """Take one sample; None, or the reason why it was refused."""
        reason = refusal(sample)
        if reason is not None:
            return reason
        sample = sample_in_floats(sample)
        before = self._snapshot
        if not before.aligned:
            self.snapshot = self._first(sample)
        elif sample.time_us <= before.time_us:
            return "not_later"
        elif self._settings.conditioned:
            self._conditioned(sample)
        else:
            self.snapshot = self._raw(sample)
        return None

    def update_velocity(self, report: VelocitySample) -> str | None:
        """Take a velocity report; None, or the reason why it was refused.

        One that is ahead of the IMU waits for the sample that reaches it. The
        paper's raw vectors have no use for velocity.
        """
        reason = refusal_of_report(report)
        if reason is not None or not self._settings.conditioned:
            return reason
        report = report_in_floats(report)
        now = self._snapshot
        if self._is_aided and report.time_us <= now.time_us:
            # it belongs to the last sample or to one just before it
            oldest_s = self._settings.aiding.oldest_report_s
            taken_now, _ = take_due((report,), now.time_us, oldest_s)
            if taken_now.given:
                if self._inside is None:
                    assert now.seen is not None  # the aiding goes with conditioned samples
                    self._go_inside(now.seen)
                hear_inside(self._inside, taken_now)
        else:
            self._snapshot = now._replace(reports=enqueue(now.reports, report))
        return None

    def _conditioned(self, sample: ImuSample) -> None:
        """One sample with the velocity reports up to it; without any, as if there were none."""
        now, aiding = self._snapshot, self._settings.aiding
        if self._inside is None:
            seen = now.seen
            if seen is None:  # the profile was one of raw vectors until now
                fresh = initial_conditioning(self._settings.conditioning)
                _, seen = self._first_seen(fresh, sample)
            self._go_inside(seen)
        dt = 1e-6 * (sample.time_us - now.time_us)
        report, ahead = NO_REPORT, now.reports
        if ahead:
            report, ahead = take_due(ahead, sample.time_us, aiding.oldest_report_s)
        gyr, acc = sample.gyr_rad_s, sample.acc_m_s2
        readings = (gyr, acc, sample.mag_gauss, sample.has_mag)
        goes_on_aided = self._is_aided and aiding.enabled and dt <= aiding.gap_s
        has_heading = advance(self._inside, *readings, dt, not goes_on_aided)
        if goes_on_aided:
            self._is_aided = advance_aided(self._inside, *readings, dt, report, self._knows_north)
            if not self._is_aided:
                known = compass.record_giving_up(self._snapshot.compass, sample.time_us)
                self._snapshot = self._snapshot._replace(compass=known)
        else:
            self._is_aided = False
            if has_heading and not self._has_heading:
                self._align_inside()
        self._has_heading = has_heading
        self._gyr_rad_s = gyr
        self._snapshot = self._snapshot._replace(time_us=sample.time_us, reports=ahead)
        if report.given and not goes_on_aided:
            self._begin_aided(sample, report)

    def _align_inside(self) -> None:
        """The first heading ever is alignment, not correction: there was none to correct."""
        if self._settings.initial is not None:
            return
        now = self.snapshot
        assert now.seen is not None  # something has been advanced
        q = align(conditioned_vectors(self._settings.reference, now.seen))
        self.snapshot = now._replace(filter=now.filter._replace(q_ned_frd=q))
        self._go_inside(now.seen)

    def _begin_aided(self, sample: ImuSample, report: Report) -> None:
        """Velocity starts to help once there is a heading from true north.

        It comes from the field, or from velocity itself where there is no field to be trusted
        or no position that tells true from magnetic north.
        """
        settings = self._settings
        if not settings.aiding.enabled:
            return
        start: Start | None
        if self._has_heading and self._knows_north and self._trusts_field():
            now = self.snapshot
            start = start_by_field(settings, now)
        elif search_inside(self._inside, report):
            now = self.snapshot
            start = start_by_velocity(now)
        else:
            return
        if start is not None:
            is_first = not self._has_heading
            self.snapshot = now = begin_aiding(
                settings, now, start, sample, report, is_first_heading=is_first
            )
            assert now.seen is not None  # the sample has been conditioned
            self._go_inside(now.seen)

    def _trusts_field(self) -> bool:
        """Whether the field may give the first heading: calibrated, and like the place's own."""
        now, place = self._snapshot, self._whereabouts.here
        if place is not None:
            seen = contents_of(self._inside).memory.magnetic
            if not resembles(place.field, seen.horizontal_reference, seen.down_reference):
                known = now.compass._replace(unlike_us=now.time_us)
                self._snapshot = now = now._replace(compass=known)
        return compass.is_trusted(now.compass, now.time_us)

    def _first_seen(
        self, memory: ConditioningState, sample: ImuSample
    ) -> tuple[ConditioningState, Conditioned]:
        """What the conditioning stage makes of a sample that nothing came before."""
        return plain(condition)(
            self._settings.conditioning,
            memory,
            sample.gyr_rad_s,
            sample.acc_m_s2,
            sample.mag_gauss,
            sample.has_mag,
            0.0,
        )

    @property
    def _knows_north(self) -> bool:
        """Whether true north is known: by the profile or by a position."""
        return self._declination_rad is not None or not self._settings.learns_north

    def _raw(self, sample: ImuSample) -> Snapshot:
        before = self.snapshot
        settings = self._settings
        state = kernel.step(
            settings.filter,
            settings.reference,
            before.filter,
            sample.gyr_rad_s,
            sample.acc_m_s2,
            sample.mag_gauss,
            sample.has_mag,
            1e-6 * (sample.time_us - before.time_us),
        )
        rate = subtract(sample.gyr_rad_s, state.gyr_bias_rad_s)
        return before._replace(
            filter=state,
            seen=None,
            time_us=sample.time_us,
            rate_rad_s=rate,
            smooth_error=self._smoothed(state.error, sample.time_us),
            aided=None,  # it does not come along, nor does what was shown so far
            aided_covariance=(),
            search=EMPTY_SEARCH,
        )

    def _smoothed(self, error: float, time_us: int) -> float:
        """The mean of e over the last second or so: one sample's e is mostly its noise."""
        dt = 1e-6 * (time_us - self.snapshot.time_us)
        before = self.snapshot.smooth_error
        return before + dt / (SIGMA_TIME_S + dt) * (error - before)

    def _first(self, sample: ImuSample) -> Snapshot:
        """Align on the first sample, or correct the given attitude; nothing has turned yet."""
        settings = self._settings
        before = self.snapshot
        acc, mag, has_mag = sample.acc_m_s2, sample.mag_gauss, sample.has_mag
        memory, seen = before.conditioning, None
        if settings.conditioned:
            memory, seen = self._first_seen(memory, sample)
            vectors = conditioned_vectors(settings.reference, seen)
        else:
            vectors = raw_vectors(settings.reference, acc, mag, has_mag)
        q = align(vectors) if settings.initial is None else settings.initial
        first_step_s = settings.filter.first_step_s
        state = plain(kernel.correct)(settings.filter, initial_state(q), vectors, first_step_s)
        rate = subtract(sample.gyr_rad_s, state.gyr_bias_rad_s)
        first = Snapshot(state, memory, seen, sample.time_us, rate, True, state.error)
        return first._replace(compass=before.compass)

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
    ) -> None:
        """Where and when it is: from magnetic to true north, if the profile leaves that open.

        A heading from magnetic north turns with the declination, so the change of reference is no
        error to be corrected. Elsewhere the field is another one, and what was concluded from
        the one that is not this place's is taken back.
        """
        if not self._settings.learns_north:
            return
        before = self._whereabouts.here
        known = said(self._whereabouts, latitude_deg, longitude_deg, altitude_m, unix_us)
        self._whereabouts = known
        if known.here is None or known.here is before:
            return
        field = known.here.field
        turn_rad = field.declination_rad - (self._declination_rad or 0.0)
        was_true = self._has_heading_by_velocity
        self._declination_rad = field.declination_rad
        self.replace_profile(self.profile)
        if before is not None and unlike(before.field, field):
            self._take_back()
        if not was_true:
            now = self.snapshot
            q = multiply(exp((0.0, 0.0, turn_rad)), now.filter.q_ned_frd)
            self.snapshot = now._replace(filter=now.filter._replace(q_ned_frd=q))

    def _take_back(self) -> None:
        """Forget what another place's field has led to: verdicts on the compass, the aiding."""
        now = self.snapshot
        self.snapshot = now._replace(
            compass=compass.restart(now.compass), aided=None, aided_covariance=()
        )

    def set_field_calibrated(self, calibrated: bool) -> None:
        """Whether somebody has calibrated the compass; it is assumed until told otherwise.

        The heading of one that is not comes from velocity, as soon as that shows it.
        """
        before = self._snapshot
        known = compass.declare(before.compass, calibrated)
        misled = compass.is_trusted(before.compass, before.time_us) and not calibrated
        self._snapshot = before._replace(compass=known)
        if self._is_aided and misled:
            self.snapshot = self.snapshot._replace(aided=None, aided_covariance=())

    def change_imu(self) -> None:
        """The samples are another IMU's from now on: its biases are its own."""
        self.snapshot = change_imu(self._settings, self.snapshot)

    def turn(self, turn_ned: Quaternion) -> None:
        """Turn the estimate by a rotation given in NED that no sensor has felt, to test recovery.

        All that is inside turns with it.
        """
        self.snapshot = apply_turn(self.snapshot, turn_ned)

    def attitude(self, time_us: int) -> Attitude:
        """The attitude at ``time_us``, propagated from the last sample for output only."""
        now = self._snapshot
        ahead_s = min(max(1e-6 * (time_us - now.time_us), 0.0), OUTPUT_HORIZON_S)
        if self._inside is not None:
            moved, figures = published_inside(
                self._inside, self._gyr_rad_s, ahead_s, self._is_aided
            )
        else:
            moved, figures = published(self._settings, now, ahead_s)
        q, rate, bias, error, error_rate, gain = moved
        gravity, magnetic, inclination, heading, has_heading = figures
        if not (self._is_aided or compass.is_trusted(now.compass, now.time_us)):
            heading = max(heading, UNCALIBRATED_SIGMA_RAD)
        return Attitude(
            time_us,
            q,
            rate,
            bias,
            error,
            error_rate,
            gain,
            gravity,
            magnetic,
            inclination,
            heading,
            self._north if has_heading else "none",
        )

    @property
    def _has_heading_by_velocity(self) -> bool:
        """Whether no field but the reports tell the heading."""
        return self._is_aided and not self._has_heading

    @property
    def _north(self) -> str:
        """What the heading is measured from; without a field it is the reports' true north."""
        given = self.profile.reference.declination_deg != "position"
        known = given or self._declination_rad is not None
        by_velocity = self._has_heading_by_velocity
        return "true" if known or by_velocity or not self._settings.conditioned else "magnetic"
