"""What one sample does to the core in compiled memory, and what the last one leaves to publish."""

from math import isfinite
from typing import Any, NamedTuple

from estimator.aiding.consistency import compare, compare_report, watch
from estimator.aiding.search import SEARCH_ANEW, add_report, add_sample
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.step import aid, take_late_report
from estimator.aiding.types import NO_REPORT, AidingParams, Report, StepInputs
from estimator.aiding.velocity_history import OLDEST_S
from estimator.arrays import Floats
from estimator.compilation.compiled import inlined, shared
from estimator.conditioning.condition import condition
from estimator.conditioning.events.axis_signs import current_errors
from estimator.conditioning.params import SPAN_S, ConditioningParams
from estimator.conditioning.rate import slow_share
from estimator.filter import kernel
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams
from estimator.geometry.quaternion import subtract
from estimator.live import turning
from estimator.live.aided import conditioned_vectors, follow_aided, horizontal_north, is_worse
from estimator.live.iron import CONTRADICTED, PROVEN, VOUCHED, mounted_rad, unshown_iron
from estimator.live.published import (
    OUTPUT_HORIZON_S,
    Published,
    aided_figures,
    conditioned_figures,
    motion,
    pulled,
    raw_figures,
    widen,
)
from estimator.live.refusal import FINE
from estimator.live.reports import MOST_WAITING, enqueue, take_due_velocities, velocity_at
from estimator.live.rows import IS_RATE, ROW, TIME, X, Y, Z
from estimator.types import NEVER_US, Between, Sample, Vec3

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

# What the filter's vectors come from.
RAW = 0
CONDITIONED = 1
AIDED = 2


class Situation(NamedTuple):
    """The part of the context that the steps need, see :mod:`estimator.live.core`."""

    source: int = RAW
    standing: int = VOUCHED  # of the compass, see :mod:`estimator.live.iron`
    rejected_until_us: int = NEVER_US  # until when that is ``CONTRADICTED``
    used_from_us: int = NEVER_US  # from when on the field counts
    knows_north: bool = False
    turned_back: tuple[float, float] = (1.0, 0.0)  # cosine and sine of the compass's own turn
    watches_gaps: bool = False
    takes_rates: bool = False  # of others beside the samples
    north: int = 0  # the place in ``NORTHS`` of what a heading by the field is measured from
    north_without: int = 0  # and of one without


class Params(NamedTuple):
    """What the compiled steps take from the profile."""

    filter: FilterParams
    reference: ReferenceParams
    conditioning: ConditioningParams
    aiding: AidingParams


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
    report, other = due_reports(handle, time_us, dt_s)
    had_heading, end = handle.seen.has_heading, TAKEN
    handle.seen = seen = condition(handle, sample)
    has_learnt = handle.gathered.time_s == 0.0
    unsensed_turn = handle.conditioning.events.unsensed_turn if has_learnt else 0.0
    search_on(handle, sample.acc_m_s2, dt_s)
    if is_aided:
        return step_aided(handle, handle.now, report, other, unsensed_turn)
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
def step_aided(
    handle: Any, now: Situation, report: Report, other: Report, unsensed_turn: float
) -> int:
    """The last sample with the velocity reports that belong to it, if any; what ends a run.

    Field and force have shown an ``unsensed_turn`` of this variance about any axis, rad^2.
    """
    params = handle.params
    reference = params.reference
    seen = handle.seen
    north = horizontal_north(reference, now.knows_north)
    events = handle.conditioning.events
    others = StepInputs(
        gravity_b=seen.gravity_b,
        gravity_sigma_rad=seen.sigma_brief_rad,
        aliasing=handle.conditioning.vertical.tilt.aliasing,
        north=north,
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
    knows_north = now.knows_north or rolls(params.aiding)
    state = follow_aided(params.filter, reference, handle.filter, aided, knows_north, before)
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
def take_report_rows(handle: Any, report_rows: Floats, next_report: int, k: int) -> tuple[int, int]:
    """Take the reports from ``next_report`` on before row k; which is next, and what ends."""
    while next_report < len(report_rows) and report_rows[next_report, ROW] <= k:
        # raw vectors use no reports
        has_shown = handle.now.source != RAW and take_report_row(handle, report_rows[next_report])
        next_report += 1
        if has_shown:
            return next_report, SHOWN_LATE
    return next_report, TAKEN


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
def due_reports(handle: Any, time_us: int, dt_s: float) -> tuple[Report, Report]:
    """The velocities that have waited for the sample of ``time_us``, of either source."""
    report, other = NO_REPORT, NO_REPORT
    if len(handle.reports) > 0:
        # one that came behind a slow stream's last sample is as old as the step is long
        handle.reports, report, other = take_due_velocities(
            handle.reports, time_us, max(OLDEST_S, dt_s)
        )
    return report, other


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


@inlined
def contradicted_axes(handle: Any) -> tuple[bool, bool, bool]:
    """Whether field and force contradict the gyroscope's axes x, y, z now.

    By more than a bias that the profile allows: such an error is not learnt.
    """
    axes = handle.conditioning.events.axes
    is_now = axes.since_s < SPAN_S
    least = handle.params.conditioning.bias_limit_rad_s**2
    x, y, z = axes.squares
    common = min(x, y, z)  # of a field that contradicts all three it is the field's own
    x, y, z = x - common, y - common, z - common
    return is_now and x > least, is_now and y > least, is_now and z > least


@inlined
def keep_rate(handle: Any, time_us: int, rate_rad_s: Vec3) -> None:
    """Keep body rates, unless they come too late.

    Those at the times of the samples are of use only where an axis is contradicted.
    """
    state = handle.turning
    is_kept = time_us > handle.time_us
    if time_us == handle.time_us:
        a, b, c = contradicted_axes(handle)
        d, e, f = state.stands_in
        is_kept = a or b or c or d or e or f
    if is_kept:
        handle.rates = turning.take_rate(state, handle.rates, time_us, rate_rad_s)


@inlined
def turn_to(handle: Any, time_us: int, gyr: Vec3) -> tuple[Between, Vec3]:
    """Up to the next sample by others' rates, too.

    Returns what those show of the turning up to there, and what the gyroscope reads, or what
    stands in for it.
    """
    state, handle.rates, between = turning.take_between(
        handle.turning, handle.rates, handle.time_us, time_us, gyr
    )
    handle.turning, gyr = turning.stand_in(state, time_us, gyr, contradicted_axes(handle))
    return between, gyr


@shared
def published_by(handle: Any, time_us: int, is_aided: bool) -> Published:
    """The output at a time, propagated from the last sample if that is before it."""
    params, now = handle.params, handle.now
    known_s = min(max(1e-6 * (time_us - handle.time_us), 0.0), OUTPUT_HORIZON_S)
    ahead_s = known_s
    error, error_rate_1_s = handle.filter.error, handle.filter.error_rate_1_s
    place_gauss = params.reference.place_gauss
    if is_aided:
        consistency = handle.consistency
        error, error_rate_1_s = consistency.error, consistency.error_rate_1_s
        figures = aided_figures(
            params.aiding,
            handle.aided,
            consistency,
            place_gauss,
            handle.covariance,
            mounted_rad(now.standing),
        )
        ahead_s += handle.aided.estimate.imu_lag_s  # the samples are that old
    elif now.source != RAW:
        standing = standing_at(now, handle.time_us)
        iron_rad = unshown_iron(params.conditioning, handle.conditioning, place_gauss, standing)
        figures = conditioned_figures(handle.seen, iron_rad)
    else:
        figures = raw_figures(params.reference, handle.smooth_error, handle.pull)
    rate_rad_s = subtract(handle.sample.gyr_rad_s, handle.filter.gyr_bias_rad_s)
    figures = widen(figures, rate_rad_s, known_s)
    moved = motion(handle.filter, rate_rad_s, ahead_s, error, error_rate_1_s)
    # the place in ``NORTHS`` of what the heading is measured from
    north = now.north if handle.seen.has_heading else now.north_without
    return (time_us, *moved, *figures, north)


@inlined
def standing_at(now: Situation, time_us: int) -> int:
    """What stands for the compass at a time, see :mod:`estimator.live.iron`."""
    return CONTRADICTED if time_us < now.rejected_until_us else now.standing
