"""What Python does itself: first and raw samples, decisions after a step, and reports."""

from types import SimpleNamespace
from typing import Any

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.sources.source import in_types_of, source_of
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import Report
from estimator.aiding.velocity_history import OLDEST_S
from estimator.compilation.compiled import plain
from estimator.conditioning.condition import condition
from estimator.filter import kernel
from estimator.filter.alignment import align
from estimator.filter.observation import raw_vectors
from estimator.filter.types import FilterState
from estimator.geometry.earth import LastPosition
from estimator.geometry.quaternion import exp, multiply, rotate
from estimator.live import kernel_handle
from estimator.live.aided import conditioned_vectors
from estimator.live.aiding_span import begin_aided, give_up, reacquire
from estimator.live.compass_check import check_compass, turns_compass
from estimator.live.core import UNSEEN, Core, with_attitude
from estimator.live.refusal import FINE, RATE_LIMIT_RAD_S, REASONS, fault_of
from estimator.live.rows import MOST_WAITING, report_row_of
from estimator.live.settings import Settings
from estimator.live.state import State
from estimator.live.step import FIRST_HEADING, GAP, LOST, REPORT, SHOWN, SHOWN_LATE
from estimator.reasons import Reason
from estimator.types import ImuSample, RateSample, Sample, VelocitySample


def first_core(settings: Settings, before: Core, sample: ImuSample) -> Core:
    """Nothing has turned yet. Plain Python: a single step is quicker so than taken into memory."""
    first = Sample(*sample[1:], dt_s=0.0)
    gathered, memory, seen = before.gathered, before.conditioning, UNSEEN
    if settings.conditioned:
        handle = SimpleNamespace(params=settings, gathered=gathered, conditioning=memory)
        seen = condition(handle, first)
        gathered, memory = handle.gathered, handle.conditioning
        vectors = conditioned_vectors(settings.reference, seen)
    else:
        vectors = raw_vectors(settings.reference, first.acc_m_s2, first.mag, first.has_mag)
    q = align(vectors) if settings.aligns else settings.initial
    first_step_s = settings.filter.first_step_s
    state = plain(kernel.correct)(settings.filter, FilterState(q), vectors, first_step_s)
    return before._replace(
        time_us=sample.time_us,
        sample=first,
        filter=state,
        smooth_error=state.error,
        gathered=gathered,
        conditioning=memory,
        seen=seen,
        reports=(),
    )


def decide(state: State, end: int) -> Reason | None:
    """Do what a step has ended for; why its sample was refused, if it was."""
    if end < len(REASONS):
        return REASONS[end]
    state.published = None
    report, has_heading = state.run(kernel_handle.last_report)
    if end & GAP:
        state.enter(Cause.GAP)
    if end & LOST:
        if not turns_compass(state):
            give_up(state)
    elif end & (SHOWN | SHOWN_LATE):
        check_aided(state, report)
    if end & FIRST_HEADING:
        state.align()
    if end & REPORT:
        begin_aided(state, report, has_heading=has_heading)
    return None


def check_aided(state: State, report: Report) -> None:
    """Check the aided attitude, then its compass, by what the search has shown."""
    if state.is_aided and not reacquire(state, report):
        check_compass(state, report)


def take_sample(state: State, sample: ImuSample) -> Reason | None:
    """Take a sample that is more than a step; None, or why it was refused."""
    time_us, *vectors, has_mag = sample
    fault = fault_of(vectors[0], vectors[1], vectors[2])
    if fault != FINE:
        return REASONS[fault]
    # floats only, as compiled code takes them: a stream may hold integers
    gyr, acc, mag = ((float(x), float(y), float(z)) for x, y, z in vectors)
    sample = ImuSample(time_us, gyr, acc, mag, bool(has_mag))
    state.published = None
    if not state.aligned:
        take_first(state, sample)
    elif sample.time_us <= state.time_us:
        return Reason.NOT_LATER
    elif state.settings.conditioned:
        take_beside(state, sample)
    else:
        state.enter(Cause.RAW_SAMPLE)
        state.change_context(reports=())
        advance(state, sample)  # nothing is wrong with it
    return None


def advance(state: State, sample: ImuSample) -> int:
    """Take the next sample, as plain numbers; why the step ended."""
    time_us, gyr, acc, mag, has_mag = sample
    _, _, end, _ = state.ready()(time_us, *gyr, *acc, *mag, has_mag, 0, 0, 0)
    return end


def take_first(state: State, sample: ImuSample) -> None:
    """Align on the first sample, or correct the given attitude; nothing has turned yet."""
    back = exp((0.0, 0.0, -state.context.compass.turned_rad))
    sample = sample._replace(mag_gauss=rotate(back, sample.mag_gauss))
    state.set_core(first_core(state.settings, state.core, sample))
    state.enter(Cause.SAMPLE if state.settings.conditioned else Cause.RAW_SAMPLE)
    state.change_context(reports=())


def take_beside(state: State, sample: ImuSample) -> None:
    """One conditioned sample behind raw ones, or with reports of others than velocity."""
    was_raw = state.context.phase is Phase.RAW
    if was_raw:
        state.enter(Cause.SAMPLE)
    # one that came behind a slow stream's last sample is as old as the step is long
    oldest_s = max(OLDEST_S, 1e-6 * (sample.time_us - state.time_us))
    due, ahead = take_due(state.context.reports, sample.time_us, oldest_s)
    state.change_context(reports=ahead)
    end = advance(state, sample)
    is_aided = state.is_aided and not end & (GAP | LOST)
    # there was a heading before
    decide(state, end & ~FIRST_HEADING if was_raw else end)
    for other in due if is_aided else ():
        take_other_report(state, other)


def take_report(state: State, report: Any) -> Reason | None:
    """Take a report of a source of aiding; None, or why it was refused.

    Raises:
        InputError: no source makes such reports, or a field is no number.
    """
    source = source_of(report)
    report = in_types_of(source.blank, report)
    reason = source.refusal(report)
    if reason is not None or not state.settings.conditioned:
        return reason
    state.ready()
    if isinstance(report, VelocitySample):
        if state.run(kernel_handle.take_report, report_row_of(0, report)):
            check_aided(state, state.run(kernel_handle.last_report)[0])
    elif state.is_aided:
        if report.time_us > state.time_us:
            waiting = (*state.context.reports, report)
            state.change_context(reports=waiting[-MOST_WAITING:])
        elif age_s(report, state.time_us) <= OLDEST_S:
            take_other_report(state, report)
    return None


def take_other_report(state: State, report: Any) -> None:
    """Take another source's report that belongs to the last sample."""
    kernel = kernel_handle.late_report_kernel(source_of(report))
    state.run(kernel, report, age_s(report, state.time_us))


def take_rate(state: State, rate: RateSample) -> Reason | None:
    """Take body rates of another message; None, or why they were refused."""
    x, y, z = rate.rate_rad_s
    if not all(abs(component) <= RATE_LIMIT_RAD_S for component in (x, y, z)):
        return Reason.GYROSCOPE_OUT_OF_RANGE  # or no number
    if state.settings.uses_rates:
        state.run(kernel_handle.take_report, report_row_of(0, rate))
    return None


def move(state: State, known: LastPosition) -> None:
    """Take another place: its field, and the turn from magnetic, or another's, to true north."""
    before, before_field = state.context.last_position, state.place_field
    declination_rad = 0.0 if before_field is None else before_field.declination_rad
    state.change_context(last_position=known)
    if known.here is None or known.here is before.here:
        return
    state.use_profile(state.profile)
    now, field = state.core, known.here.field
    if not state.is_aided or (now.seen.has_heading and not rolls(state.settings.aiding)):
        # magnetic until now, or by another place's declination; by velocity it is true already
        turn = exp((0.0, 0.0, field.declination_rad - declination_rad))
        state.set_core(with_attitude(now, multiply(turn, now.filter.q_ned_frd)))
    if before_field is not None and compass.differ(before_field, field):
        # verdicts on the compass, and the aiding, were drawn from another place's field
        state.enter(Cause.MISLED)
        if state.context.compass.turned_rad != 0.0:
            state.turn_compass(-state.context.compass.turned_rad)
        state.change_context(compass=compass.restart(state.context.compass))


def take_due(
    waiting: tuple[Any, ...], time_us: int, oldest_s: float
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The latest of each type that the IMU has reached, and those ahead of it."""
    ahead = tuple(report for report in waiting if report.time_us > time_us)
    reached = sorted((r for r in waiting if r not in ahead), key=lambda report: report.time_us)
    latest = {type(report): report for report in reached}
    return tuple(r for r in latest.values() if age_s(r, time_us) <= oldest_s), ahead


def age_s(report: Any, time_us: int) -> float:
    """How long before ``time_us`` it was measured."""
    return 1e-6 * (time_us - int(report.time_us))
