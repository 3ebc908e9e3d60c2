"""The core, resident in compiled memory.

The core is some two hundred numbers, with velocity aiding five hundred. To
hand them to a compiled step and take them back costs Python fifty microseconds
and more, the step itself about one. So an estimator leaves them handle and
hands over samples only; all of it can be taken out and put back at any time.
"""

import functools
from math import isfinite
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core import types
from numba.experimental import structref

from estimator.aiding import (
    AidingParams,
    Report,
    StepInputs,
    aid,
    is_credible,
    take_late_report,
)
from estimator.aiding.consistency import compare, compare_report, watch
from estimator.aiding.correction import correct_last, prediction_at
from estimator.aiding.search import EMPTY_SEARCH, add_report, add_sample
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import NO_REPORT, SIZE
from estimator.aiding.velocity_history import OLDEST_S
from estimator.arrays import Floats
from estimator.compilation.compiled import Function, compiled, inlined, shared
from estimator.conditioning import (
    Conditioned,
    ConditioningParams,
    ConditioningState,
    condition,
)
from estimator.conditioning.times import SPAN_S
from estimator.conditioning.vertical.rate import slow_share
from estimator.filter import kernel
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.quaternion import subtract
from estimator.live import turning
from estimator.live.aided import (
    conditioned_vectors,
    follow_aided,
    horizontal_north,
    is_worse,
)
from estimator.live.core import Core, in_arrays, initial_core
from estimator.live.iron import DOUBTED, VOUCHED, mounted_rad, unshown_iron
from estimator.live.published import (
    NOTHING_PUBLISHED,
    OUTPUT_HORIZON_S,
    Published,
    aided_figures,
    conditioned_figures,
    motion,
    pulled,
    raw_figures,
    widen,
    write,
)
from estimator.live.refusal import FINE, fault_of, is_gap, usual_interval
from estimator.live.reports import enqueue_velocity, take_due_velocities
from estimator.live.rows import (
    HAS_VERTICAL,
    IS_RATE,
    LATE_S,
    NO_REPORT_ROWS,
    NO_ROWS,
    NOTHING_TO_SAY,
    REPORT_SIZE,
    ROW,
    SIGMA_M_S,
    TIME,
    Rows,
    X,
    Y,
    Z,
    reading_of,
)
from estimator.live.settings import Settings, settings_of
from estimator.profile import load_profile
from estimator.types import NEVER_US, NOTHING_BETWEEN, ZERO_VEC3, Between, Sample, Vec3

# numba ships no types
_numba_config: Any = numba.config
_typeof: Any = numba.typeof

# Time over which e is averaged for the sigma of raw vectors: one sample's e is mostly its noise.
SIGMA_TIME_S = 1.0

# Why steps end: there are no more samples; one is refused, see :mod:`estimator.live.refusal`; or
# the last one leaves something to decide, each a bit of a number.
TAKEN = FINE
FIRST_HEADING = 8  # it has report_rows the first heading
GAP = 16  # it came so late that it was taken without velocity
REPORT = 32  # a velocity belongs to it that nothing has begun with yet
LOST = 64  # the aided attitude is not credible
SHOWN = 128  # velocity alone may have shown the attitude anew
SHOWN_LATE = 256  # likewise a report behind it
NOT_FINITE_NOW = 512  # it has left no finite attitude

# What the filter's vectors come from.
RAW = 0
CONDITIONED = 1
AIDED = 2


class Situation(NamedTuple):
    """What the steps ask of the context, see :mod:`estimator.live.core`."""

    source: int = RAW
    standing: int = VOUCHED  # of the compass, see :mod:`estimator.live.iron`
    doubted_until_us: int = NEVER_US  # until when that is ``DOUBTED``
    heard_from_us: int = NEVER_US  # from when on the field counts
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


FIELDS = ("params", "now", "report", "rows", "published", "report_rows", *Core._fields)
# No arrays are laid.
NOTHING_LAID = (NO_ROWS, NOTHING_TO_SAY, NO_REPORT_ROWS)
NO_ROW = np.zeros(REPORT_SIZE)  # of what others show


if _numba_config.DISABLE_JIT:

    def KernelHandle(*values: Any) -> Any:  # noqa: N802 - in compiled code it is a type
        """What compiled memory is in plain Python: an object with these fields."""
        return SimpleNamespace(**dict(zip(FIELDS, values, strict=True)))
else:

    class KernelHandle(structref.StructRefProxy):  # type: ignore[no-redef]
        """A handle on ``params`` and the fields of a :class:`Core`; made by :func:`resident`."""

    @structref.register
    class KernelHandleType(types.StructRef):
        """How numba sees it."""

    _structref: Any = structref
    _kernel_handle_type: Any = KernelHandleType
    _structref.define_boxing(KernelHandleType, KernelHandle)
    _structref.define_constructor(KernelHandle, KernelHandleType, list(FIELDS))


def params_of(settings: Settings) -> Params:
    """What the kernels take of the settings."""
    return Params(settings.filter, settings.reference, settings.conditioning, settings.aiding)


@functools.cache
def example_types() -> tuple[tuple[Any, ...], Any]:
    """The types of what :func:`resident` is called with, and of the handle that it returns."""
    settings = settings_of(load_profile("imu"))
    params, core = params_of(settings), in_arrays(initial_core(settings))
    first = (params, Situation(), NO_REPORT, *NOTHING_LAID)
    fields = zip(FIELDS, (*first, *core), strict=True)
    handle = _kernel_handle_type([(field, _typeof(value)) for field, value in fields])
    return tuple(map(_typeof, (params, core, Situation(), *NOTHING_LAID))), handle


def takes_handle(function: Function) -> Function:
    """A kernel that takes a handle; :func:`arguments_with` has the types of its arguments."""
    kernel = compiled(types=lambda: arguments_with(example_types()[1])[kernel])(function)
    return kernel


@functools.cache
def arguments_with(handle: Any) -> dict[Any, tuple[Any, ...]]:
    """The types of the arguments of all kernels that take a handle, which is of type ``handle``."""
    number, flag = types.float64, types.boolean
    whole = types.int64
    readings = (number,) * 9
    return {
        contents: (handle,),
        clock: (handle,),
        contradicted_axes: (handle,),
        advance_raw: (handle, whole, *readings, flag),
        advance: (handle, whole, *readings, flag, whole, whole, whole),
        brief: (handle, _typeof(Situation())),
        lay: (handle, *(_typeof(value) for value in NOTHING_LAID)),
        take_rate: (handle, whole, number, number, number),
        turning_of: (handle,),
        take_report: (handle, _typeof(NO_ROW)),
        last_report: (handle,),
        search: (handle, _typeof(NO_REPORT)),
        publish: (handle, whole),
    }


@compiled(types=lambda: example_types()[0])
def kernel_handle(
    params: Params, core: Core, now: Situation, rows: Rows, published: Floats, report_rows: Floats
) -> Any:
    """Put everything handle; the arrays as in :func:`lay`."""
    return KernelHandle(params, now, NO_REPORT, rows, published, report_rows, *core[:])


@takes_handle
def contents(handle: Any) -> Core:
    """Take the core out; the covariance is a copy."""
    return Core(
        time_us=handle.time_us,
        usual_s=handle.usual_s,
        sample=handle.sample,
        filter=handle.filter,
        smooth_error=handle.smooth_error,
        pull=handle.pull,
        conditioning=handle.conditioning,
        seen=handle.seen,
        search=handle.search,
        aided=handle.aided,
        consistency=handle.consistency,
        covariance=handle.covariance.copy(),
        velocity_history=handle.velocity_history.copy(),
        turning=handle.turning,
        rates=handle.rates[: handle.turning.waiting].copy(),
        reports=handle.reports.copy(),
    )


@takes_handle
def clock(handle: Any) -> tuple[int, float]:
    """Time (us) of the last sample, and the interval (s) that samples usually come at."""
    return handle.time_us, handle.usual_s


@takes_handle
def contradicted_axes(handle: Any) -> tuple[bool, bool, bool]:
    """Whether field and force contradict the gyroscope's axes x, y, z now.

    By more than a bias that the profile allows: such an error is not learnt.
    """
    axes = handle.conditioning.events.signs.axes
    is_now = axes.since_s < SPAN_S
    least = handle.params.conditioning.bias_limit_rad_s**2
    x, y, z = axes.squares
    common = min(x, y, z)  # of a field that contradicts all three it is the field's own
    x, y, z = x - common, y - common, z - common
    return is_now and x > least, is_now and y > least, is_now and z > least


@takes_handle
def advance_raw(
    handle: Any,
    time_us: int,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    mx: float,
    my: float,
    mz: float,
    has_mag: bool,
) -> int:
    """One sample of raw vectors; returns what is wrong with it, ``TAKEN`` if nothing is."""
    end = fault_of((gx, gy, gz), (ax, ay, az), (mx, my, mz), time_us > handle.time_us)
    if end != FINE:
        return end
    dt_s = 1e-6 * (time_us - handle.time_us)
    sample = Sample(
        gyr_rad_s=(gx, gy, gz),
        acc_m_s2=(ax, ay, az),
        mag=(mx, my, mz),
        has_mag=has_mag,
        dt_s=dt_s,
        between=NOTHING_BETWEEN,
    )
    params = handle.params
    state = kernel.step(params.filter, params.reference, handle.filter, sample)
    before = handle.smooth_error
    handle.pull = pulled(
        handle.pull, handle.filter.q_ned_frd, state, sample.gyr_rad_s, before, dt_s
    )
    handle.smooth_error = before + dt_s / (SIGMA_TIME_S + dt_s) * (state.error - before)
    handle.filter = state
    handle.sample = sample
    handle.time_us = time_us
    handle.usual_s = usual_interval(handle.usual_s, dt_s)
    return TAKEN


@takes_handle
def advance(
    handle: Any,
    time_us: int,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    mx: float,
    my: float,
    mz: float,
    has_mag: bool,
    first: int,
    behind: int,
    next_report: int,
) -> tuple[int, int, int, Published]:
    """One conditioned sample, or the rows from ``first`` up to ``behind`` of those that are laid.

    A sample is plain numbers because those cost the least to hand over; ``behind`` is 0 then.
    Before each row come the reports that are laid with it, from ``next_report`` on.

    Returns the row and the report that would be next, what has ended it there, and what there is
    to publish of the last sample.
    """
    now = handle.now
    memory, seen, state = handle.conditioning, handle.seen, handle.filter
    laid, out, report_rows = handle.rows, handle.published, handle.report_rows
    sample, last_us, usual_s = handle.sample, handle.time_us, handle.usual_s
    gyr, acc, mag = (gx, gy, gz), (ax, ay, az), (mx, my, mz)
    # others read of the memory meanwhile
    is_read = now.source == AIDED or turning.has_rates(handle.turning) or len(report_rows) > 0
    published, is_aided, k, end = NOTHING_PUBLISHED, now.source == AIDED, first, TAKEN
    while end == TAKEN and k < max(1, behind):
        if behind > 0:
            time_us, gyr, acc, mag, has_mag = reading_of(laid, k)
            next_report, end = take_report_rows(handle, report_rows, next_report, k)
        if end == TAKEN:
            end = fault_of(gyr, acc, mag, time_us > last_us)
        if end != TAKEN:
            break
        dt_s = 1e-6 * (time_us - last_us)
        between = NOTHING_BETWEEN
        if now.takes_rates and turning.has_rates(handle.turning):
            between, gyr = turn_to(handle, time_us, gyr)
        if now.watches_gaps and not between.given and is_gap(usual_s, dt_s):
            is_aided, end = False, GAP
        has_mag = has_mag and time_us >= now.heard_from_us
        c, s = now.turned_back  # as a compass reads it that is not turned about the body's down
        x, y, z = mag if has_mag else ZERO_VEC3
        mag = (c * x + s * y, c * y - s * x, z)
        sample = Sample(
            gyr_rad_s=gyr, acc_m_s2=acc, mag=mag, has_mag=has_mag, dt_s=dt_s, between=between
        )
        last_us, usual_s = time_us, usual_interval(usual_s, dt_s)
        ends, memory, seen, state, published = step(
            handle, sample, last_us, memory, seen, state, is_aided, is_read
        )
        end |= ends
        if behind > 0:
            write(out[k], published, is_aided)
        k += 1
    if k > first:
        keep(handle, last_us, memory, seen, sample)
        handle.usual_s, handle.filter = usual_s, state
        if not is_aided:
            handle.smooth_error = state.error
    return k, next_report, end, published


@inlined
def step(
    handle: Any,
    sample: Sample,
    time_us: int,
    memory: ConditioningState,
    seen: Conditioned,
    state: FilterState,
    is_aided: bool,
    is_read: bool,
) -> tuple[int, ConditioningState, Conditioned, FilterState, Published]:
    """One sound sample: what it leaves to decide, the states after it and what there is to say.

    Where it ``is_read``, all that is handle is of this sample, too.
    """
    params, now, dt_s = handle.params, handle.now, sample.dt_s
    report, other = due_reports(handle, time_us, dt_s)
    had_heading, end = seen.has_heading, TAKEN
    memory, seen = condition(params.conditioning, memory, sample)
    search_on(handle, memory, sample.acc_m_s2, dt_s)
    if is_read:
        keep(handle, time_us, memory, seen, sample)
    if is_aided:
        end = step_aided(handle, now, report, other)
        state = handle.filter
        published = published_by(handle, time_us)
    else:
        state = kernel.turn_on(state, seen.turn, seen.rate_rad_s, seen.bias_rad_s)
        vectors = conditioned_vectors(params.reference, seen)
        state = kernel.correct(params.filter, state, vectors, dt_s)
        published = published_now(time_us, params, now, memory, seen, state, sample.gyr_rad_s)
        if seen.has_heading and not had_heading:
            end = FIRST_HEADING
        if report.given and params.aiding.enabled:
            handle.report = report
            end |= REPORT
    q = state.q_ned_frd
    if not isfinite(q[0] + q[1] + q[2] + q[3]):
        end |= NOT_FINITE_NOW
    return end, memory, seen, state, published


@inlined
def keep(
    handle: Any, time_us: int, memory: ConditioningState, seen: Conditioned, sample: Sample
) -> None:
    """Put handle what a sample has changed of the conditioning stage."""
    handle.conditioning = memory
    handle.seen = seen
    handle.sample = sample
    handle.time_us = time_us


@inlined
def take_report_rows(handle: Any, report_rows: Floats, next_report: int, k: int) -> tuple[int, int]:
    """Take the reports from ``next_report`` on before row k; which is next, and what ends."""
    while next_report < len(report_rows) and report_rows[next_report, ROW] <= k:
        has_shown = take_report_row(handle, report_rows[next_report])
        next_report += 1
        if has_shown:
            return next_report, SHOWN_LATE
    return next_report, TAKEN


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
def search_on(handle: Any, memory: ConditioningState, acc: Vec3, dt_s: float) -> None:
    """Follow the force for the search by velocity, if that has begun."""
    if dt_s > SPAN_S:  # how the vehicle has turned meanwhile is not known
        handle.search = EMPTY_SEARCH
    elif handle.search.window.is_open:
        vertical = memory.vertical
        handle.search = add_sample(
            handle.search, vertical.gravity.q_g_frd, acc, dt_s, vertical.tilt.aliasing
        )


@inlined
def published_now(
    time_us: int,
    params: Params,
    now: Situation,
    memory: ConditioningState,
    seen: Conditioned,
    state: FilterState,
    gyr: Vec3,
) -> Published:
    """What a conditioned sample without velocity leaves to be published."""
    iron_rad = unshown_iron(
        params.conditioning, memory, params.reference.place_gauss, standing_at(now, time_us)
    )
    rate = subtract(gyr, state.gyr_bias_rad_s)
    moved = motion(state, rate, 0.0, state.error, state.error_rate_1_s)
    return time_us, moved, conditioned_figures(seen, iron_rad), north_of(now, seen)


@inlined
def standing_at(now: Situation, time_us: int) -> int:
    """What stands for the compass at a time, see :mod:`estimator.live.iron`."""
    return DOUBTED if time_us < now.doubted_until_us else now.standing


@inlined
def north_of(now: Situation, seen: Conditioned) -> int:
    """The place in ``NORTHS`` of what the heading is measured from."""
    return now.north if seen.has_heading else now.north_without


@takes_handle
def brief(handle: Any, now: Situation) -> None:
    """Tell the steps what they ask of the context."""
    handle.now = now


@takes_handle
def lay(handle: Any, rows: Rows, published: Floats, report_rows: Floats) -> None:
    """Lay arrays for :func:`advance`, as in :mod:`estimator.live.rows`."""
    handle.rows = rows
    handle.published = published
    handle.report_rows = report_rows


@takes_handle
def take_rate(handle: Any, time_us: int, x: float, y: float, z: float) -> None:
    """Body rates of another messenger."""
    keep_rate(handle, time_us, (x, y, z))


@inlined
def keep_rate(handle: Any, time_us: int, rate_rad_s: Vec3) -> None:
    """Keep body rates, unless they come too late.

    At the very times of the samples they are of use only where those are in doubt.
    """
    state = handle.turning
    is_kept = time_us > handle.time_us
    if time_us == handle.time_us:
        a, b, c = contradicted_axes(handle)
        d, e, f = state.stands_in
        is_kept = a or b or c or d or e or f
    if is_kept:
        handle.turning, handle.rates = turning.take_rate(state, handle.rates, time_us, rate_rad_s)


@inlined
def turn_to(handle: Any, time_us: int, gyr: Vec3) -> tuple[Between, Vec3]:
    """Up to the next sample by others' rates, too.

    Returns what those show of the turning up to there, and what the gyroscope reads, or what
    stands in for it.
    """
    state, between = turning.take_between(
        handle.turning, handle.rates, handle.time_us, time_us, gyr
    )
    handle.turning, gyr = turning.stand_in(state, time_us, gyr, contradicted_axes(handle))
    return between, gyr


@takes_handle
def turning_of(handle: Any) -> tuple[int, tuple[bool, bool, bool]]:
    """Steps that were integrated through others' rates, and the axes that they stand in for."""
    return handle.turning.used, handle.turning.stands_in


@inlined
def step_aided(handle: Any, now: Situation, report: Report, other: Report) -> int:
    """The last sample with the velocity reports that belong to it, if any; what ends a run."""
    params = handle.params
    reference = params.reference
    seen = handle.seen
    north = horizontal_north(reference, now.knows_north)
    others = StepInputs(
        gravity_b=seen.gravity_b,
        gravity_sigma_rad=seen.sigma_brief_rad,
        aliasing=handle.conditioning.vertical.tilt.aliasing,
        north=north,
        place_gauss=reference.place_gauss,
    )
    aided, covariance, velocity_history = aid(
        params.aiding,
        handle.aided,
        handle.covariance,
        handle.velocity_history,
        handle.sample,
        report,
        others,
    )
    before = handle.aided.estimate.q_ned_frd
    knows_north = now.knows_north or rolls(params.aiding)
    state = follow_aided(params.filter, reference, handle.filter, aided, knows_north, before)
    handle.filter = state
    handle.smooth_error = state.error
    handle.aided = aided
    handle.covariance = covariance
    handle.velocity_history = velocity_history
    consistency = watch(params.aiding, handle.consistency, aided, handle.sample, report)
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
    time_us, vector = int(row[TIME]), (row[X], row[Y], row[Z])
    if row[IS_RATE] > 0.0:
        keep_rate(handle, time_us, vector)
        return False
    if handle.now.source != AIDED or time_us > handle.time_us:
        handle.reports = enqueue_velocity(handle.reports, row)
        return False
    ago_s = 1e-6 * (handle.time_us - time_us)
    if ago_s > OLDEST_S:
        return False
    has_vertical = row[HAS_VERTICAL] > 0.0
    report = Report(True, vector, has_vertical, row[SIGMA_M_S], ago_s, row[LATE_S])
    handle.report = report
    return take_late(handle, report)


@takes_handle
def take_report(handle: Any, row: Floats) -> bool:
    """See :func:`take_report_row`."""
    return take_report_row(handle, row)


@shared
def take_late(handle: Any, report: Report) -> bool:
    """A report that belongs to the last sample, and comes behind it.

    Returns whether velocity alone may have shown the attitude anew.
    """
    aided, covariance = take_late_report(
        handle.params.aiding,
        handle.aided,
        handle.covariance,
        handle.velocity_history,
        handle.seen.gravity_b,
        report,
    )
    handle.aided = aided
    handle.covariance = covariance
    handle.consistency = compare_report(
        handle.params.aiding, handle.consistency, aided.estimate, report
    )
    return search_by(handle, report)


@takes_handle
def last_report(handle: Any) -> tuple[Report, bool]:
    """The report that a step has left to decide on, and whether the field shows a heading."""
    return handle.report, handle.seen.has_heading


@functools.cache
def hearing(observe: Any) -> Any:
    """The step that takes a late report of one source, by what its report teaches.

    See :class:`estimator.aiding.sources.source.Source`.
    """

    def take_other_report(handle: Any, report: Any, ago_s: float) -> None:
        """A report measured ``ago_s`` before the last sample."""
        now = prediction_at(handle.aided, handle.covariance, handle.velocity_history)
        x = np.zeros(SIZE)
        observe(handle.params.aiding, now, report, ago_s, x)
        handle.aided = correct_last(handle.aided, now, x)
        handle.covariance = now.covariance

    # the name of its file in the cache
    take_other_report.__qualname__ = (
        f"take_other_report.{observe.__module__}.{observe.__qualname__}"
    )
    return compiled(take_other_report)


@inlined
def search_by(handle: Any, report: Report) -> bool:
    """Take a report for the attitude by velocity alone; whether it may have shown that."""
    found, last = handle.search, handle.sample
    q_g_frd = handle.conditioning.vertical.gravity.q_g_frd
    if not found.window.is_open:  # nobody has followed the force until now
        found = add_sample(found, q_g_frd, last.acc_m_s2, last.dt_s, 0.0)
    found, closed = add_report(found, report, q_g_frd, handle.seen.gravity_b)
    handle.search = found
    return bool(closed)


@takes_handle
def search(handle: Any, report: Report) -> bool:
    """A report while there is no aiding; whether it may have shown the attitude."""
    return search_by(handle, report)


@shared
def published_by(handle: Any, time_us: int) -> Published:
    """What there is to publish at a time, turned on from the last sample if that is before it."""
    params, now = handle.params, handle.now
    known_s = min(max(1e-6 * (time_us - handle.time_us), 0.0), OUTPUT_HORIZON_S)
    ahead_s = known_s
    error, error_rate_1_s = handle.filter.error, handle.filter.error_rate_1_s
    place_gauss = params.reference.place_gauss
    if now.source == AIDED:
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
    elif now.source == CONDITIONED:
        standing = standing_at(now, handle.time_us)
        iron_rad = unshown_iron(params.conditioning, handle.conditioning, place_gauss, standing)
        figures = conditioned_figures(handle.seen, iron_rad)
    else:
        figures = raw_figures(params.reference, handle.smooth_error, handle.pull)
    rate_rad_s = subtract(handle.sample.gyr_rad_s, handle.filter.gyr_bias_rad_s)
    figures = widen(figures, rate_rad_s, known_s)
    moved = motion(handle.filter, rate_rad_s, ahead_s, error, error_rate_1_s)
    return time_us, moved, figures, north_of(now, handle.seen)


@takes_handle
def publish(handle: Any, time_us: int) -> Published:
    """See :func:`published_by`."""
    return published_by(handle, time_us)
