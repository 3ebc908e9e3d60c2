"""One vehicle's estimator: samples in, attitude out. No I/O and no clock."""

from math import isfinite, radians
from typing import Any

from estimator.aiding import Report, compass
from estimator.aiding.lean import bears_out
from estimator.aiding.phase import Cause, Phase, after
from estimator.aiding.place import PlaceField, differ, resembles, update_whereabouts
from estimator.aiding.sources.source import in_types_of
from estimator.aiding.sources.table import source_of
from estimator.aiding.types import NO_REPORT
from estimator.conditioning.condition import initial_state as initial_conditioning
from estimator.conditioning.rate import slow_share
from estimator.filter.alignment import align
from estimator.geometry.quaternion import exp, multiply
from estimator.live.aiding_start import (
    Start,
    begin_again,
    begin_aiding,
    start_by_field,
    start_by_velocity,
)
from estimator.live.conditioned import conditioned_vectors
from estimator.live.core import (
    Core,
    apply_turn,
    change_imu,
    initial_core,
    with_attitude,
    without_aiding,
    without_conditioning,
)
from estimator.live.first_sample import first_core
from estimator.live.holder import Holder
from estimator.live.interval import is_gap, usual_interval
from estimator.live.published import NOTHING_SAID, Said, write
from estimator.live.refusal import (
    GYR_LIMIT_RAD_S,
    REASONS,
    refusal,
    sample_in_floats,
)
from estimator.live.reports import age_s, enqueue, report_with_age, take_due
from estimator.live.resident import (
    AIDED,
    CONDITIONED,
    FIRST_HEADING,
    NOT_FINITE_NOW,
    NOT_LATER,
    NOTHING_LAID,
    RAW,
    TAKEN,
)
from estimator.live.rows import Floats, Rows, cut
from estimator.live.settings import settings_of
from estimator.live.snapshot import Context, Snapshot
from estimator.live.turning import STILL, hear_rate, take_between
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import (
    NOTHING_BETWEEN,
    Attitude,
    ImuSample,
    Quaternion,
    RateSample,
    Vec3,
    VelocitySample,
)

# The output is propagated this far beyond the last sample at most, s; then the
# last rate says nothing about the vehicle any more.
OUTPUT_HORIZON_S = 1.0
# The heading by a compass that is not calibrated.
UNCALIBRATED_SIGMA_RAD = radians(45.0)
# What the filter's vectors come from, as the compiled output takes it.
SOURCE = {
    Phase.EMPTY: RAW,
    Phase.RAW: RAW,
    Phase.UNAIDED: CONDITIONED,
    Phase.SEARCHING: CONDITIONED,
    Phase.AIDED: AIDED,
}
# In place of a sample, where rows of them are laid.
NO_SAMPLE_ITSELF = (0, *(0.0,) * 9, False)
# Looked up in its class, a member of an enumeration takes longer than a comparison.
_EMPTY, _RAW, _UNAIDED, _AIDED = Phase.EMPTY, Phase.RAW, Phase.UNAIDED, Phase.AIDED

_new: Any = tuple.__new__


class Estimator:
    """The filter of a profile, fed sample by sample.

    The state is a :class:`~estimator.live.core.Core`, which compiled steps change and which
    lives in their memory, and a :class:`~estimator.live.snapshot.Context` beside it.
    """

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        self._fixed_gain = fixed_gain
        self.profile = profile
        self._settings = settings_of(profile, fixed_gain)
        self._set_context(Context())
        self._set_core(initial_core(self._settings))

    @property
    def snapshot(self) -> Snapshot:
        """The whole state. Set it to resume from it."""
        context = self._context._replace(time_us=self._time_us, usual_s=self._usual_s)
        return Snapshot(self._core.core, context)

    @snapshot.setter
    def snapshot(self, snapshot: Snapshot) -> None:
        self._set_context(snapshot.context)
        self._settings = settings_of(self.profile, self._fixed_gain, self._declination_rad)
        self._set_core(snapshot.core)

    def _set_core(self, core: Core) -> None:
        self._core = Holder(self._settings, core)
        self._said: Said = NOTHING_SAID  # what the last sample's step has said
        self._said_us: int | None = None  # when, if it still holds
        self._looked_at: Context | None = None

    def _set_context(self, context: Context) -> None:
        """A new context. What changes at each sample is kept beside it until somebody asks."""
        self._context = context
        self._time_us, self._usual_s = context.time_us, context.usual_s

    def replace_profile(self, profile: Profile) -> None:
        """Use other parameters from the next sample on; the estimate stays.

        All or nothing: what a profile raises, it raises before anything has changed.
        """
        settings = settings_of(profile, self._fixed_gain, self._declination_rad)
        derived = initial_conditioning(settings.conditioning).coefficients
        now = self._core.core
        self.profile, self._settings = profile, settings
        # what the memory has derived from the other parameters
        memory = now.conditioning._replace(coefficients=derived)
        self._set_core(now._replace(conditioning=memory))

    def restart(self) -> None:
        """Forget the attitude and align anew, as after the vehicle's reboot."""
        known = self._context
        self._set_context(
            Context(compass=compass.restart(known.compass), whereabouts=known.whereabouts)
        )
        self._set_core(initial_core(self._settings))

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude yet."""
        return self._context.phase is not _EMPTY

    def update(self, sample: ImuSample) -> Reason | None:
        """Take one sample; None, or the reason why it was refused."""
        return self.take(*sample)

    def take(
        self, time_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3, mag_gauss: Vec3, has_mag: bool
    ) -> Reason | None:
        """Take the fields of an :class:`ImuSample`, as :meth:`update` does: it is one call less."""
        if self._looked_at is not self._context:
            self._look()
        if not self._needs_samples_only:
            return self._take_any(ImuSample(time_us, gyr_rad_s, acc_m_s2, mag_gauss, has_mag))
        _, end, _, self._time_us, self._usual_s, self._said = self._core.advance(
            time_us,
            *gyr_rad_s,
            *acc_m_s2,
            *mag_gauss,
            has_mag,
            self._time_us,
            self._usual_s,
            False,
            0,
        )
        if end == TAKEN:
            self._said_us = time_us
            return None
        self._said_us = None
        return self._end_rows(end)

    def update_rows(self, rows: Rows, said: Floats) -> int:
        """Take rows as long as there is nothing to do but to take them.

        To ``said`` (N, columns as in :mod:`estimator.live.rows`) the attitude after each row is
        written. Returns the first row that was not taken: one for :meth:`update`, which knows what
        to do with it, or N. Behind a row whose attitude is not finite nothing is taken either.
        """
        taken, end, n = 0, FIRST_HEADING, len(said)
        while end == FIRST_HEADING and taken < n:
            if self._looked_at is not self._context:
                self._look()
            if not self._needs_samples_only or not self._trusts_compass:
                break
            self._core.lay(cut(rows, taken), said[taken:])
            done, end, _, self._time_us, self._usual_s, _ = self._core.advance(
                *NO_SAMPLE_ITSELF, self._time_us, self._usual_s, False, n - taken
            )
            self._core.lay(*NOTHING_LAID)
            self._said_us = None
            taken += done
            if end == FIRST_HEADING:
                self._align()
                write(said[taken - 1], self._core.publish(0.0, CONDITIONED))
        return taken

    def _look(self) -> None:
        """What follows from the context, once for each: it is asked for at each sample."""
        now = self._looked_at = self._context
        self._source = SOURCE[now.phase]
        self._needs_samples_only = (
            self._settings.conditioned
            and now.phase is _UNAIDED
            and not now.reports
            and now.turning is STILL
        )
        self._norths = self.norths

    def _end_rows(self, end: int) -> Reason | None:
        """What a row has come to that was not simply taken."""
        if end == FIRST_HEADING:
            self._align()
            return None
        if end == NOT_FINITE_NOW:
            return None
        return Reason.NOT_LATER if end == NOT_LATER else REASONS[end]

    def _take_any(self, sample: ImuSample) -> Reason | None:
        """One sample in any phase."""
        reason = refusal(sample)
        if reason is not None:
            return reason
        sample = sample_in_floats(sample)
        if not self.aligned:
            self._take_first(sample)
        elif sample.time_us <= self._time_us:
            return Reason.NOT_LATER
        elif self._settings.conditioned:
            self._take_conditioned(sample)
        else:
            self._take_raw(sample)
        return None

    def update_velocity(self, report: VelocitySample) -> Reason | None:
        """Take a velocity report, see :meth:`update_report`."""
        return self.update_report(report)

    def update_rate(self, rate: RateSample) -> Reason | None:
        """Take body rates of another messenger, see :meth:`update_report`."""
        return self.update_report(rate)

    def update_report(self, report: Any) -> Reason | None:
        """Take what something beside the IMU has measured; None, or why it was refused.

        A report of a source of aiding (:mod:`estimator.aiding.sources.table`), such as a
        :class:`VelocitySample`, waits for the sample that reaches its time. All but velocity
        count only while velocity helps. The paper's raw vectors have no use for any. A
        :class:`RateSample` shows the turning between the IMU samples around it, if it agrees
        with those.

        Raises:
            InputError: no source makes reports of this type, or one of its fields is no number.
        """
        if isinstance(report, RateSample):
            return self._take_rate(report)
        source = source_of(report)
        report = in_types_of(source.blank, report)
        reason = source.refusal(report)
        if reason is not None or not self._settings.conditioned:
            return reason
        now = self._context
        is_aided = now.phase is _AIDED
        if is_aided and report.time_us <= self._time_us:
            # it belongs to the last sample or to one just before it
            if age_s(report, self._time_us) <= self._settings.aiding.oldest_report_s:
                self._core.hear(report, self._time_us)
        elif is_aided or isinstance(report, VelocitySample):
            self._context = now._replace(reports=enqueue(now.reports, report))
        return None

    def _take_rate(self, rate: RateSample) -> Reason | None:
        if not all(isfinite(w) and abs(w) <= GYR_LIMIT_RAD_S for w in rate.rate_rad_s):
            return Reason.GYROSCOPE_OUT_OF_RANGE
        now = self._context
        if self.profile.uses_attitude_rates and rate.time_us > self._time_us:
            self._context = now._replace(turning=hear_rate(now.turning, rate))
        return None

    @property
    def rates(self) -> str:
        """Whose rates the turning was integrated through: "imu", or "imu+attitude"."""
        return "imu+attitude" if self._context.turning.used else "imu"

    def _enter(self, cause: Cause) -> None:
        """Go on to the phase that follows; what does not come along is made blank."""
        before = self._context.phase
        phase = after(before, cause)
        if phase is before:
            return
        if phase is _RAW:
            self._set_core(without_conditioning(self._settings, self._core.core))
        elif before is _AIDED:
            self._set_core(without_aiding(self._settings, self._core.core))
        self._context = self._context._replace(phase=phase)

    def _take_first(self, sample: ImuSample) -> None:
        """Align on the first sample, or correct the given attitude; nothing has turned yet."""
        self._set_core(first_core(self._settings, self._core.core, sample))
        is_conditioned = self._settings.conditioned
        self._enter(Cause.SAMPLE if is_conditioned else Cause.RAW_SAMPLE)
        self._context = self._context._replace(reports=())
        self._time_us = sample.time_us

    def _take_raw(self, sample: ImuSample) -> None:
        """One sample of the paper's vectors."""
        if self._context.phase is not _RAW:
            self._enter(Cause.RAW_SAMPLE)
        dt_s = 1e-6 * (sample.time_us - self._time_us)
        readings = (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)
        self._core.advance_raw(*readings, sample.has_mag, dt_s)
        self._time_us, self._usual_s = sample.time_us, usual_interval(self._usual_s, dt_s)
        self._said_us = None

    def _take_conditioned(self, sample: ImuSample) -> None:
        """One sample with the velocity reports up to it; without any, as if there were none."""
        now, aiding = self._context, self._settings.aiding
        time_us = sample.time_us
        dt_s = 1e-6 * (time_us - self._time_us)
        between = NOTHING_BETWEEN
        if now.turning is not STILL and self.profile.uses_attitude_rates:
            turning, between = take_between(now.turning, self._time_us, time_us, sample.gyr_rad_s)
            self._context = now._replace(turning=turning)
        if now.phase is not _UNAIDED:
            self._enter(self._cause_at(dt_s, is_seen=between.given))
        if between.given:  # to the core that the phase has left
            self._core.see_between(between)
        due: tuple[Any, ...] = ()
        if now.reports:
            # one that came behind a slow stream's last sample is as old as the step is long
            oldest_s = max(aiding.oldest_report_s, dt_s)
            due, ahead = take_due(now.reports, time_us, oldest_s)
            self._context = self._context._replace(reports=ahead)
        velocity = next((r for r in due if isinstance(r, VelocitySample)), None)
        report = NO_REPORT if velocity is None else report_with_age(velocity, time_us)
        is_aided = self._context.phase is _AIDED
        _, end, has_heading, self._time_us, self._usual_s, _ = self._core.advance(
            time_us,
            *sample.gyr_rad_s,
            *sample.acc_m_s2,
            *sample.mag_gauss,
            sample.has_mag,
            self._time_us,
            self._usual_s,
            is_aided,
            0,
        )
        self._said_us = None
        if is_aided:
            if not self._core.advance_aided(report, self._knows_north):
                self._give_up()
                return
            for other in due:
                if other is not velocity:
                    self._core.hear(other, time_us)
            return
        if end == FIRST_HEADING and now.phase is not _RAW:
            self._align()
        if report.given and aiding.enabled:
            self._begin_aided(report, has_heading=has_heading)

    def _cause_at(self, dt_s: float, *, is_seen: bool) -> Cause:
        """What a sample means that comes ``dt_s`` after the one before.

        ``is_seen``: others have seen the turning between the two.
        """
        aiding = self._settings.aiding
        if self._context.phase is _RAW:
            return Cause.SAMPLE
        if not aiding.enabled:
            return Cause.SWITCH_OFF
        is_long = not is_seen and is_gap(aiding.gap_s, self._usual_s, dt_s)
        return Cause.GAP if is_long else Cause.SAMPLE

    def _give_up(self) -> None:
        """Velocity does not help any more; the compass may be the reason.

        An attitude that the reports' acceleration bears out is no reason to fall back on the
        unaided one: then the aiding begins anew from its own.
        """
        now, core = self._context, self._core.core
        if bears_out(core.aided.lean):
            self._set_core(begin_again(self._settings, self.snapshot))
            return
        known = compass.record_giving_up(now.compass, self._time_us)
        self._context = now._replace(compass=known)
        self._enter(Cause.GIVE_UP)
        if core.seen.has_heading and slow_share(core.sample.dt_s) > 0.0:
            self._align()

    def _align(self) -> None:
        """The first heading ever is alignment, not correction: there was none to correct."""
        if self._settings.initial is None:
            now = self._core.core
            q = align(conditioned_vectors(self._settings.reference, now.seen))
            self._set_core(with_attitude(now, q))

    def _begin_aided(self, report: Report, *, has_heading: bool) -> None:
        """Velocity starts to help once there is a heading from true north.

        It comes from the field, or from velocity itself where there is no field to be trusted
        or no position that tells true from magnetic north.
        """
        settings = self._settings
        start: Start | None = None
        if has_heading and self._knows_north and self._trusts_field() and self._is_settled():
            start = start_by_field(settings, self._core.core)
        elif self._core.search(report):
            start = start_by_velocity(self._core.core)
        if start is None:
            self._enter(Cause.REPORT)
            return
        now = self._context
        is_calibrated = compass.is_trusted(now.compass, self._time_us)
        core = begin_aiding(settings, self.snapshot, start, report, is_calibrated=is_calibrated)
        if not has_heading or slow_share(core.sample.dt_s) > 0.0:
            # there was none to correct, or correcting it would take many slow steps
            core = with_attitude(core, start.q_ned_frd)
        self._set_core(core)
        self._enter(Cause.BEGIN)

    def _is_settled(self) -> bool:
        """Whether the unaided vertical has gone through its averaging time since it began."""
        age_s = self._core.core.conditioning.gravity.force.age_s
        return age_s >= self._settings.conditioning.gravity_tau_s

    def _trusts_field(self) -> bool:
        """Whether the field may give the first heading: calibrated, and like the place's own."""
        now, place = self._context, self._context.whereabouts.here
        if place is not None:
            learnt = self._core.core.conditioning.magnetic.reference
            if not resembles(place.field, learnt.horizontal, learnt.down):
                known = now.compass._replace(unlike_us=self._time_us)
                self._context = now = now._replace(compass=known)
        return compass.is_trusted(now.compass, self._time_us)

    @property
    def _declination_rad(self) -> float | None:
        place = self._context.whereabouts.here
        return None if place is None else place.field.declination_rad

    @property
    def place_field(self) -> PlaceField | None:
        """The Earth's field where the vehicle is, None if nobody has said where."""
        place = self._context.whereabouts.here
        return None if place is None else place.field

    @property
    def _knows_north(self) -> bool:
        """Whether true north is known: by the profile or by a position."""
        return self._context.whereabouts.here is not None or not self._settings.learns_north

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
        before = self._context.whereabouts.here
        known = update_whereabouts(
            self._context.whereabouts, latitude_deg, longitude_deg, altitude_m, unix_us
        )
        if known.here is None or known.here is before:
            self._context = self._context._replace(whereabouts=known)
            return
        field = known.here.field
        turn_rad = field.declination_rad - (self._declination_rad or 0.0)
        self._context = self._context._replace(whereabouts=known)
        self.replace_profile(self.profile)
        now = self._core.core
        if self._context.phase is not _AIDED or now.seen.has_heading:
            # magnetic until now, or by another place's declination; by velocity it is true already
            turned = multiply(exp((0.0, 0.0, turn_rad)), now.filter.q_ned_frd)
            self._set_core(with_attitude(now, turned))
        if before is not None and differ(before.field, field):
            self._take_back()

    def _take_back(self) -> None:
        """Forget what another place's field has led to: verdicts on the compass, and the aiding."""
        now = self._context
        self._context = now._replace(compass=compass.restart(now.compass))
        self._enter(Cause.MISLED)

    def set_field_calibrated(self, calibrated: bool) -> None:
        """Whether somebody has calibrated the compass; it is assumed until told otherwise.

        The heading of one that is not comes from velocity, as soon as that shows it.
        """
        before = self._context
        self._context = before._replace(compass=compass.declare(before.compass, calibrated))
        if compass.is_trusted(before.compass, self._time_us) and not calibrated:
            self._enter(Cause.MISLED)

    def change_imu(self) -> None:
        """The samples are another IMU's from now on: its biases are its own."""
        is_aided = self._context.phase is _AIDED
        self._set_core(change_imu(self._settings, self._core.core, is_aided=is_aided))

    def turn(self, turn_ned: Quaternion) -> None:
        """Turn the estimate by a rotation given in NED that no sensor has felt, to test recovery.

        All that is inside turns with it.
        """
        is_aided = self._context.phase is _AIDED
        self._set_core(apply_turn(self._core.core, turn_ned, is_aided=is_aided))

    def attitude(self, time_us: int) -> Attitude:
        """The attitude at ``time_us``, propagated from the last sample for output only."""
        if self._looked_at is not self._context:
            self._look()
        said = self._said
        if time_us != self._said_us:
            ahead_s = min(max(1e-6 * (time_us - self._time_us), 0.0), OUTPUT_HORIZON_S)
            said = self._core.publish(ahead_s, self._source)
        moved, figures, has_heading = said
        if self._source != AIDED and not self._trusts_compass:
            gravity, magnetic, inclination, heading = figures
            figures = (gravity, magnetic, inclination, max(heading, UNCALIBRATED_SIGMA_RAD))
        # an Attitude's own constructor takes three times as long
        values = (time_us, *moved, *figures, self._norths[not has_heading])
        attitude: Attitude = _new(Attitude, values)
        return attitude

    @property
    def _trusts_compass(self) -> bool:
        known = self._context.compass
        return known is compass.UNTOUCHED or compass.is_trusted(known, self._time_us)

    @property
    def norths(self) -> tuple[str, str]:
        """What the heading is measured from: with a field that has told one, and without."""
        source = SOURCE[self._context.phase]
        given = self.profile.reference.declination_deg != "position"
        known = given or self._context.whereabouts.here is not None
        north = "true" if known or not self._settings.conditioned else "magnetic"
        if source == RAW:
            return north, north
        return north, "none" if source == CONDITIONED else "true"  # by the reports' velocity
