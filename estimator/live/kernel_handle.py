"""The core in compiled memory, and the kernels that Python calls with a handle on it.

The core is some two hundred numbers, with velocity aiding five hundred. Passing them to a compiled
step and back costs Python over fifty microseconds, the step itself about one. So an estimator
passes samples only. It can take out the whole core, or put in another, at any time.
"""

import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numba.core import types
from numba.experimental import structref

from estimator.aiding.inertial import correct_last, prediction_at
from estimator.aiding.sources.source import Source
from estimator.aiding.types import NO_REPORT, SIZE, Report
from estimator.compilation.compiled import (
    Function,
    compiled,
    entry_point,
    is_compiled_code,
    types_of,
)
from estimator.live.core import Core, in_arrays, initial_core
from estimator.live.published import NOTHING_PUBLISHED, Published, published_by, write
from estimator.live.refusal import fault_of, is_gap, mean_interval
from estimator.live.rows import (
    NO_OUTPUT,
    NO_REPORT_ROWS,
    NO_ROWS,
    REPORT_SIZE,
    Rows,
    is_due,
    reading_of,
)
from estimator.live.settings import Settings, settings_of
from estimator.live.situation import AIDED, RAW, Situation
from estimator.live.step import (
    GAP,
    SHOWN_LATE,
    TAKEN,
    search_by,
    step,
    take_report_row,
)
from estimator.live.turning import Axes, contradicted_axes, has_rates, take_between
from estimator.profile import load_profile
from estimator.types import NOTHING_BETWEEN, ZERO_VEC3, Floats, Sample

FIELDS = ("params", "now", "report", "rows", "published", "report_rows", *Core._fields)
# Outside of a run of rows.
NO_ROWS_BOUND = (NO_ROWS, NO_OUTPUT, NO_REPORT_ROWS)
NUMBER, FLAG, WHOLE = types.float64, types.boolean, types.int64
SAMPLE = (WHOLE, *(NUMBER,) * 9, FLAG)


if not is_compiled_code():

    def KernelHandle(*values: Any) -> Any:  # noqa: N802 - in compiled code it is a type
        """What compiled memory is in plain Python: an object with these fields."""
        return SimpleNamespace(**dict(zip(FIELDS, values, strict=True)))
else:

    class KernelHandle(structref.StructRefProxy):  # type: ignore[no-redef]
        """A handle on these fields; :func:`new_handle` makes it."""

    @structref.register
    class KernelHandleType(types.StructRef):
        """How numba sees it."""

    _structref: Any = structref
    _kernel_handle_type: Any = KernelHandleType
    _structref.define_boxing(KernelHandleType, KernelHandle)
    _structref.define_constructor(KernelHandle, KernelHandleType, list(FIELDS))


@functools.cache
def example_types() -> tuple[tuple[Any, ...], Any]:
    """The types of the arguments of :func:`new_handle`, and of the handle that it returns."""
    params = settings_of(load_profile("imu"))
    core = initial_core(params)
    first = (params, Situation(), NO_REPORT, *NO_ROWS_BOUND)
    fields = zip(FIELDS, (*first, *core), strict=True)
    handle = _kernel_handle_type([(field, *types_of(value)) for field, value in fields])
    return types_of(params, core, Situation(), *NO_ROWS_BOUND), handle


def takes_handle(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a function of a handle and of ``arguments``, each a type of numba or an example."""
    others = [a if isinstance(a, types.Type) else types_of(a)[0] for a in arguments]
    return compiled(types=lambda: (example_types()[1], *others))


@compiled(types=lambda: example_types()[0])
def new_handle(
    params: Settings, core: Core, now: Situation, rows: Rows, published: Floats, report_rows: Floats
) -> Any:
    """Put everything into compiled memory; the arrays as in :func:`bind_rows`."""
    return KernelHandle(params, now, NO_REPORT, rows, published, report_rows, *core[:])


def put(settings: Settings, core: Core) -> Any:
    """A handle on a copy of the core in compiled memory."""
    own = in_arrays(core)  # steps write into them
    return entry_point(new_handle)(settings, own, Situation(), *NO_ROWS_BOUND)


@takes_handle()
def contents(handle: Any) -> Core:
    """Take the core out; the covariance is a copy."""
    return Core(
        conditioning=handle.conditioning,
        aided=handle.aided,
        covariance=handle.covariance.copy(),
        velocity_history=handle.velocity_history.copy(),
        time_us=handle.time_us,
        interval_s=handle.interval_s,
        sample=handle.sample,
        filter=handle.filter,
        smooth_error=handle.smooth_error,
        pull=handle.pull,
        gathered=handle.gathered,
        seen=handle.seen,
        search=handle.search,
        consistency=handle.consistency,
        turning=handle.turning,
        rates=handle.rates.copy(),
        reports=handle.reports.copy(),
    )


@takes_handle()
def status(handle: Any) -> tuple[int, int, Axes, Axes]:
    """Time (us) of the last sample, and others' rates in use.

    That is how many steps were integrated through those rates, the gyroscope's axes that they
    replace, and the axes that field and force contradict.
    """
    used, replaced = handle.turning.used, handle.turning.stands_in
    return handle.time_us, used, replaced, contradicted_axes(handle)


@takes_handle(*SAMPLE, WHOLE, WHOLE, WHOLE)
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
    """One sample, or the bound rows from ``first`` up to ``behind``.

    A sample is plain numbers, the cheapest to pass; ``behind`` is 0 then. The reports bound with a
    row come before it, from ``next_report`` on. Returns the next row and report, why it ended
    there, and the last sample's output.
    """
    now, rows, report_rows = handle.now, handle.rows, handle.report_rows
    gyr, acc, mag = (gx, gy, gz), (ax, ay, az), (mx, my, mz)
    published, is_aided, k, end = NOTHING_PUBLISHED, now.source == AIDED, first, TAKEN
    while end == TAKEN and k < max(1, behind):
        if behind > 0:
            time_us, gyr, acc, mag, has_mag = reading_of(rows, k)
            while end == TAKEN and is_due(report_rows, next_report, k):
                # raw vectors use no reports
                if now.source != RAW and take_report_row(handle, report_rows[next_report]):
                    end = SHOWN_LATE
                next_report += 1
        if end == TAKEN:
            end = fault_of(gyr, acc, mag, time_us > handle.time_us)
        if end != TAKEN:
            break
        dt_s = 1e-6 * (time_us - handle.time_us)
        between = NOTHING_BETWEEN
        if handle.params.uses_rates and has_rates(handle):
            between, gyr = take_between(handle, time_us, gyr)
        if now.watches_gaps and not between.given and is_gap(handle.interval_s, dt_s):
            is_aided, end = False, GAP
        has_mag = has_mag and time_us >= now.used_from_us
        c, s = now.turned_back  # as a compass reads it that is not turned about the body's down
        x, y, z = mag if has_mag else ZERO_VEC3
        mag = (c * x + s * y, c * y - s * x, z)
        sample = Sample(
            gyr_rad_s=gyr, acc_m_s2=acc, mag=mag, has_mag=has_mag, dt_s=dt_s, between=between
        )
        handle.interval_s = mean_interval(handle.interval_s, dt_s)
        end |= step(handle, sample, time_us, is_aided)
        published = published_by(handle, time_us, is_aided)
        if behind > 0:
            write(handle.published[k], published, is_aided)
        k += 1
    return k, next_report, end, published


@takes_handle(Situation())
def set_situation(handle: Any, now: Situation) -> None:
    """Set what the steps need to know of the context."""
    handle.now = now


@takes_handle(*NO_ROWS_BOUND)
def bind_rows(handle: Any, rows: Rows, published: Floats, report_rows: Floats) -> None:
    """Bind arrays for :func:`advance`, as in :mod:`estimator.live.rows`."""
    handle.rows = rows
    handle.published = published
    handle.report_rows = report_rows


@takes_handle(np.zeros(REPORT_SIZE))
def take_report(handle: Any, row: Floats) -> bool:
    """See :func:`estimator.live.step.take_report_row`."""
    return take_report_row(handle, row)


@takes_handle()
def last_report(handle: Any) -> tuple[Report, bool]:
    """The report that a step has left to decide on, and whether the field shows a heading."""
    return handle.report, handle.seen.has_heading


@takes_handle(NO_REPORT)
def search(handle: Any, report: Report) -> bool:
    """A report while there is no aiding; whether it may have shown the attitude."""
    return search_by(handle, report)


@takes_handle(WHOLE)
def publish(handle: Any, time_us: int) -> Published:
    """See :func:`published_by`."""
    return published_by(handle, time_us, handle.now.source == AIDED)


@functools.cache
def late_report_kernel(source: Source) -> Any:
    """The kernel that takes a late report of a source."""
    observe: Any = source.observe

    def take_other_report(handle: Any, report: Any, ago_s: float) -> None:
        """A report measured ``ago_s`` before the last sample."""
        now = prediction_at(handle.aided, handle.covariance, handle.velocity_history)
        x = np.zeros(SIZE)
        observe(handle.params.aiding, now, report, ago_s, x)
        handle.aided = correct_last(handle.aided, now, x)
        handle.covariance = now.covariance

    # the name of its file in the cache
    name = f"take_other_report.{observe.__module__}.{observe.__qualname__}"
    take_other_report.__qualname__ = name
    return takes_handle(source.blank, NUMBER)(take_other_report)
