"""One sample into the state, in any phase."""

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.types import NO_REPORT
from estimator.aiding.velocity_history import OLDEST_S
from estimator.geometry.quaternion import exp, rotate
from estimator.live.aiding_span import begin_aided, give_up
from estimator.live.compass_check import check_compass
from estimator.live.first_sample import first_core
from estimator.live.interval import is_gap
from estimator.live.refusal import refusal, sample_in_floats
from estimator.live.reports import report_with_age, take_due
from estimator.live.resident import FIRST_HEADING
from estimator.live.state import State
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample


def take_sample(state: State, sample: ImuSample) -> Reason | None:
    """Take a sample; None, or why it was refused."""
    reason = refusal(sample)
    if reason is not None:
        return reason
    sample = sample_in_floats(sample)
    state.said = None
    known = state.context.compass
    if known.turned_rad != 0.0:
        as_mounted = rotate(exp((0.0, 0.0, -known.turned_rad)), sample.mag_gauss)
        sample = sample._replace(mag_gauss=as_mounted)
    elif compass.is_contradicted(known, sample.time_us):
        sample = sample._replace(mag_gauss=ZERO_VEC3, has_mag=False)
    if state.context.phase is Phase.EMPTY:
        take_first(state, sample)
    elif sample.time_us <= state.core.time_us:
        return Reason.NOT_LATER
    elif state.settings.conditioned:
        take_conditioned(state, sample)
    else:
        take_raw(state, sample)
    return None


def take_first(state: State, sample: ImuSample) -> None:
    """Align on the first sample, or correct the given attitude; nothing has turned yet."""
    state.set_core(first_core(state.settings, state.core.core, sample))
    state.enter(Cause.SAMPLE if state.settings.conditioned else Cause.RAW_SAMPLE)
    state.change_context(reports=())


def take_raw(state: State, sample: ImuSample) -> None:
    """One sample of the paper's vectors."""
    if state.context.phase is not Phase.RAW:
        state.enter(Cause.RAW_SAMPLE)
    readings = (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)
    state.core.advance_raw(sample.time_us, *readings, sample.has_mag)  # nothing is wrong with it


def take_conditioned(state: State, sample: ImuSample) -> None:
    """One sample with the reports up to it; without any, as if there were none."""
    now, time_us = state.context, sample.time_us
    last_us, usual_s = state.core.clock
    dt_s = 1e-6 * (time_us - last_us)
    gyr_rad_s, is_seen = sample.gyr_rad_s, False
    if now.has_rates and state.profile.uses_attitude_rates:
        is_seen, x, y, z = state.core.turn_on(time_us, *gyr_rad_s)
        gyr_rad_s = (x, y, z)
    if now.phase is not Phase.UNAIDED:
        state.enter(cause_of(state, usual_s, dt_s, is_seen=is_seen))
    due = take_reports(state, time_us, dt_s)
    velocity = next((report for report in due if isinstance(report, VelocitySample)), None)
    report = NO_REPORT if velocity is None else report_with_age(velocity, time_us)
    is_aided = state.context.phase is Phase.AIDED
    readings = (*gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)
    _, end, has_heading, _ = state.core.advance(
        time_us, *readings, sample.has_mag, is_aided, 0, state.standing
    )
    if is_aided:
        is_credible, has_shown = state.core.advance_aided(report, state.knows_north)
        if not is_credible:
            give_up(state)
            return
        if has_shown:
            check_compass(state, report)
        for other in due:
            if other is not velocity:
                state.core.hear(other, time_us)
        return
    if end == FIRST_HEADING and now.phase is not Phase.RAW:
        state.align()
    if report.given and state.settings.aiding.enabled:
        begin_aided(state, report, has_heading=has_heading)


def take_reports(state: State, time_us: int, dt_s: float) -> tuple[object, ...]:
    """The reports that wait no longer than for the sample of ``time_us``."""
    waiting = state.context.reports
    if not waiting:
        return ()
    # one that came behind a slow stream's last sample is as old as the step is long
    oldest_s = max(OLDEST_S, dt_s)
    due, ahead = take_due(waiting, time_us, oldest_s)
    state.change_context(reports=ahead)
    return due


def cause_of(state: State, usual_s: float, dt_s: float, *, is_seen: bool) -> Cause:
    """What a sample means that comes ``dt_s`` after the one before, ``usual_s`` as a rule.

    ``is_seen``: others have seen the turning between the two.
    """
    aiding = state.settings.aiding
    if state.context.phase is Phase.RAW:
        return Cause.SAMPLE
    if not aiding.enabled:
        return Cause.SWITCH_OFF
    is_long = not is_seen and is_gap(usual_s, dt_s)
    return Cause.GAP if is_long else Cause.SAMPLE
