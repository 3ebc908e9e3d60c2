"""What one sample does to the core in compiled memory."""

from math import isfinite
from typing import Any

from estimator.aiding.consistency import compare, compare_report, watch
from estimator.aiding.search import SEARCH_ANEW, add_report, add_sample, shows_motion
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.step import aid, take_late_report
from estimator.aiding.types import NO_REPORT, Report, StepInputs
from estimator.aiding.velocity_history import OLDEST_S
from estimator.compilation.compiled import inlined, shared
from estimator.conditioning.condition import condition
from estimator.conditioning.events.axis_signs import current_errors
from estimator.conditioning.params import SPAN_S
from estimator.conditioning.rate import slow_share
from estimator.filter import kernel
from estimator.live.aided import conditioned_vectors, follow_aided, horizontal_north, is_worse
from estimator.live.published import pulled
from estimator.live.refusal import FINE
from estimator.live.rows import (
    IS_RATE,
    MOST_WAITING,
    TIME,
    X,
    Y,
    Z,
    enqueue,
    take_due_velocities,
    velocity_at,
)
from estimator.live.situation import AIDED, PROVEN, RAW
from estimator.live.turning import keep_rate
from estimator.types import Floats, Sample, Vec3

# Why steps end: no more samples, a refused one (:mod:`estimator.live.refusal`), or bits that show
# what the last one leaves to decide.
TAKEN = FINE
FIRST_HEADING = 8  # it has given the first heading
GAP = 16  # it came so late that it was taken without velocity
REPORT = 32  # a velocity belongs to it that nothing has begun with yet
LOST = 64  # the aided attitude is not credible
SHOWN = 128  # the search by velocity may have found the attitude
SHOWN_LATE = 256  # likewise a report behind it
NOT_FINITE_NOW = 512  # it has left no finite attitude

# Time over which e is averaged for the sigma of raw vectors: one sample's e is mostly its noise.
SIGMA_TIME_S = 1.0


@inlined
def step(handle: Any, sample: Sample, time_us: int, is_aided: bool) -> int:
    """One sound sample; returns what it leaves to decide."""
    end = TAKEN
    handle.sample, handle.time_us = sample, time_us
    if handle.now.source == RAW:
        step_raw(handle, sample)
    else:
        end = step_conditioned(handle, sample, time_us, is_aided)
    q = handle.filter.q_ned_frd
    if not isfinite(q[0] + q[1] + q[2] + q[3]):
        end |= NOT_FINITE_NOW
    return end


@inlined
def step_raw(handle: Any, sample: Sample) -> None:
    """The paper's step, on raw vectors."""
    before, dt_s = handle.smooth_error, sample.dt_s
    q, params = handle.filter.q_ned_frd, handle.params
    state = kernel.step(params.filter, params.reference, handle.filter, sample)
    handle.pull = pulled(handle.pull, q, state, sample.gyr_rad_s, before, dt_s)
    handle.smooth_error = before + dt_s / (SIGMA_TIME_S + dt_s) * (state.error - before)
    handle.filter = state


@inlined
def step_conditioned(handle: Any, sample: Sample, time_us: int, is_aided: bool) -> int:
    """A step on conditioned vectors; returns what it leaves to decide."""
    params, dt_s = handle.params, sample.dt_s
    report, other = NO_REPORT, NO_REPORT
    if len(handle.reports) > 0:
        # one that came behind a slow stream's last sample is as old as the step is long
        oldest_s = max(OLDEST_S, dt_s)
        handle.reports, report, other = take_due_velocities(handle.reports, time_us, oldest_s)
    had_heading, end = handle.seen.has_heading, TAKEN
    handle.gathered = handle.gathered._replace(goes=shows_motion(handle.search.window))
    handle.seen = seen = condition(handle, sample)
    has_learnt = handle.gathered.time_s == 0.0
    unsensed_turn = handle.conditioning.events.unsensed_turn if has_learnt else 0.0
    search_on(handle, sample.acc_m_s2, dt_s)
    if is_aided:
        return step_aided(handle, report, other, unsensed_turn)
    state = kernel.turn_on(handle.filter, seen.turn, seen.rate_rad_s, seen.bias_rad_s)
    vectors = conditioned_vectors(params.reference, seen)
    state = kernel.correct(params.filter, state, vectors, dt_s)
    handle.filter, handle.smooth_error = state, state.error
    if seen.has_heading and not had_heading:
        end = FIRST_HEADING
    if report.given and params.aiding.enabled:
        handle.report = report
        end |= REPORT
    return end


@inlined
def step_aided(handle: Any, report: Report, other: Report, unsensed_turn: float) -> int:
    """The last sample with the velocity reports that belong to it, if any; what ends a run.

    Field and force have shown an ``unsensed_turn`` of this variance about any axis, rad^2.
    """
    params, now, seen = handle.params, handle.now, handle.seen
    reference, events = params.reference, handle.conditioning.events
    others = StepInputs(
        gravity_b=seen.gravity_b,
        gravity_sigma_rad=seen.sigma_brief_rad,
        aliasing=handle.conditioning.vertical.tilt.aliasing,
        north=horizontal_north(reference, now.knows_north),
        place_gauss=reference.place_gauss,
        unsensed_turn=unsensed_turn,
        force_scatter=events.gravity.force_scatter,
        wrong_force=handle.consistency.wrong_force,
        gyr_errors=current_errors(events.axes, now.standing == PROVEN),
    )
    before = handle.aided.estimate.q_ned_frd
    aided, handle.covariance, handle.velocity_history = aid(
        params.aiding,
        handle.aided,
        handle.covariance,
        handle.velocity_history,
        handle.sample,
        report,
        others,
    )
    handle.aided = aided
    state = follow_aided(handle, before)
    handle.filter, handle.smooth_error = state, state.error
    consistency = watch(
        params.aiding, handle.consistency, aided, handle.covariance, handle.sample, report
    )
    tau_s = params.filter.rate_time_constant_s
    handle.consistency = compare(consistency, state.q_ned_frd, handle.sample.dt_s, tau_s)
    has_shown = report.given and search_by(handle, report)
    is_lost = slow_share(handle.sample.dt_s) > 0.0 and is_worse(aided, seen)
    if is_lost or not is_credible(aided):
        return LOST
    if other.given:
        take_late(handle, other)
    if has_shown:
        handle.report = report
    return SHOWN if has_shown else TAKEN


@inlined
def take_report_row(handle: Any, row: Floats) -> bool:
    """A row of what others have measured; whether it may have shown the attitude anew.

    A velocity waits for its sample, unless that was the last one or one just before it.
    """
    time_us = int(row[TIME])
    if row[IS_RATE] > 0.0:
        keep_rate(handle, time_us, (row[X], row[Y], row[Z]))
        return False
    if handle.now.source != AIDED or time_us > handle.time_us:
        handle.reports = enqueue(handle.reports, row, MOST_WAITING)
        return False
    report = velocity_at(row, handle.time_us, OLDEST_S)
    if not report.given:
        return False
    handle.report = report
    return take_late(handle, report)


@shared
def take_late(handle: Any, report: Report) -> bool:
    """A report that belongs to the last sample, and comes behind it.

    Returns whether the search by velocity may have found the attitude.
    """
    aided, handle.covariance = take_late_report(
        handle.params.aiding,
        handle.aided,
        handle.covariance,
        handle.velocity_history,
        handle.seen.gravity_b,
        report,
    )
    handle.aided = aided
    handle.consistency = compare_report(
        handle.params.aiding, handle.consistency, aided, handle.covariance, report
    )
    return search_by(handle, report)


@inlined
def search_on(handle: Any, acc: Vec3, dt_s: float) -> None:
    """Follow the force for the search by velocity, if that has begun."""
    if dt_s > SPAN_S:  # how the vehicle has turned meanwhile is not known
        handle.search = SEARCH_ANEW
    elif handle.search.window.is_open:
        q_g_frd, aliasing = handle.gathered.q_g_frd, handle.conditioning.vertical.tilt.aliasing
        handle.search = add_sample(handle.search, q_g_frd, acc, dt_s, aliasing)


@inlined
def search_by(handle: Any, report: Report) -> bool:
    """Take a report for the search by velocity; whether it shows something new."""
    found, last = handle.search, handle.sample
    q_g_frd = handle.gathered.q_g_frd
    if not found.window.is_open:  # the force was not followed until now
        found = add_sample(found, q_g_frd, last.acc_m_s2, last.dt_s, 0.0)
    found, has_shown = add_report(found, report, q_g_frd, handle.seen.gravity_b)
    handle.search = found
    return bool(has_shown)
