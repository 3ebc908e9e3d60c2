"""The conditioned filter's state, resident in compiled memory.

The state is some two hundred numbers, with velocity aiding five hundred. To
hand them to a compiled step and take them back costs Python fifty microseconds
and more, the step itself about one. So an estimator leaves them inside and
hands over samples only; all of it can be taken out and put back at any time.
"""

from typing import Any, NamedTuple

import numba
from numba.core import types
from numba.experimental import structref

from estimator.aiding import AidingParams, AidingState, Report, is_credible, take_late_report
from estimator.aiding.search import EMPTY_SEARCH, Search, add_report, add_sample
from estimator.aiding.types import Array
from estimator.compilation.compiled import compiled
from estimator.conditioning.condition import condition
from estimator.conditioning.types import Conditioned, ConditioningParams, ConditioningState
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.quaternion import subtract
from estimator.live.aided import aided_step
from estimator.live.conditioned import follow_conditioned
from estimator.live.published import Figures, Motion, aided_figures, conditioned_figures, motion
from estimator.live.reports import NO_REPORT
from estimator.types import ZERO_VEC3, Vec3

# numba ships no types
_numba_config: Any = numba.config
_typeof: Any = numba.typeof


class Contents(NamedTuple):
    """What is inside. ``aided`` and its ``covariance`` count only while velocity helps."""

    params: FilterParams
    reference: ReferenceParams
    conditioning: ConditioningParams
    aiding: AidingParams
    filter: FilterState
    memory: ConditioningState
    seen: Conditioned
    aided: AidingState
    covariance: Array
    search: Search


if _numba_config.DISABLE_JIT:

    class Resident:
        """The same in plain Python."""

        def __init__(self, *values: Any) -> None:
            for name, value in zip(Contents._fields, values, strict=True):
                setattr(self, name, value)

else:

    class Resident(structref.StructRefProxy):  # type: ignore[no-redef]
        """A handle on the :class:`Contents`; made by :func:`resident`."""

    @structref.register
    class ResidentType(types.StructRef):
        """How numba sees it."""

    _structref: Any = structref
    _resident_type: Any = ResidentType
    _structref.define_boxing(ResidentType, Resident)
    _structref.define_constructor(Resident, ResidentType, list(Contents._fields))


def arguments_of(contents: Contents) -> dict[Any, tuple[Any, ...]]:
    """What numba calls the types that each kernel here is called with; not in plain Python."""
    fields = zip(Contents._fields, contents, strict=True)
    inside = _resident_type([(name, _typeof(value)) for name, value in fields])
    vector, number, flag = _typeof(ZERO_VEC3), types.float64, types.boolean
    sample = (vector, vector, vector, flag, number)
    report = _typeof(NO_REPORT)
    return {
        resident: (_typeof(contents),),
        contents_of: (inside,),
        advance: (inside, *sample, flag),
        advance_aided: (inside, *sample, report, flag),
        hear_inside: (inside, report),
        search_inside: (inside, report),
        published_inside: (inside, vector, number, flag),
    }


@compiled
def resident(contents: Contents) -> Any:
    """Put everything inside."""
    return Resident(
        contents.params,
        contents.reference,
        contents.conditioning,
        contents.aiding,
        contents.filter,
        contents.memory,
        contents.seen,
        contents.aided,
        contents.covariance,
        contents.search,
    )


@compiled
def contents_of(inside: Any) -> Contents:
    """Take everything out; the covariance is a copy."""
    return Contents(
        inside.params,
        inside.reference,
        inside.conditioning,
        inside.aiding,
        inside.filter,
        inside.memory,
        inside.seen,
        inside.aided,
        inside.covariance.copy(),
        inside.search,
    )


@compiled
def advance(
    inside: Any,
    gyr_rad_s: Vec3,
    acc_m_s2: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt: float,
    follow: bool,
) -> bool:
    """One sample, ``dt`` after the one before; whether there is a heading now.

    Without ``follow`` the filter waits for the same sample's :func:`advance_aided`.
    """
    memory, seen = condition(
        inside.conditioning, inside.memory, gyr_rad_s, acc_m_s2, mag, has_mag, dt
    )
    inside.memory = memory
    inside.seen = seen
    if follow:
        inside.filter = follow_conditioned(inside.params, inside.reference, inside.filter, seen, dt)
        if dt > inside.aiding.gap_s:  # how the vehicle has turned meanwhile is not known
            inside.search = EMPTY_SEARCH
        else:
            inside.search = add_sample(inside.search, memory.gravity.q_g_frd, acc_m_s2, dt)
    return bool(seen.magnetic_weight > 0.0)


@compiled
def advance_aided(
    inside: Any,
    gyr_rad_s: Vec3,
    acc_m_s2: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt: float,
    report: Report,
    knows_north: bool,
) -> bool:
    """The same sample with the velocity report that belongs to it, if any; whether to go on aided.

    A kernel of its own: all in one would compile the conditioning stage twice.
    """
    state, aided, covariance = aided_step(
        inside.params,
        inside.reference,
        inside.aiding,
        inside.filter,
        inside.aided,
        inside.covariance,
        inside.seen.gravity_b,
        gyr_rad_s,
        acc_m_s2,
        mag,
        has_mag,
        dt,
        report,
        knows_north,
    )
    inside.filter = state
    inside.aided = aided
    inside.covariance = covariance
    return bool(is_credible(inside.aiding, aided))


@compiled
def hear_inside(inside: Any, report: Report) -> None:
    """A report that belongs to the last sample."""
    aided, covariance = take_late_report(
        inside.aiding, inside.aided, inside.covariance, inside.seen.gravity_b, report
    )
    inside.aided = aided
    inside.covariance = covariance


@compiled
def search_inside(inside: Any, report: Report) -> bool:
    """A report while there is no aiding; whether it may have shown the attitude."""
    search, closed = add_report(inside.search, report, inside.aiding.report_lag_s)
    inside.search = search
    return closed


@compiled
def published_inside(
    inside: Any, gyr_rad_s: Vec3, ahead_s: float, is_aided: bool
) -> tuple[Motion, Figures]:
    """What there is to publish, turned ``ahead_s`` beyond the last sample.

    Some twenty numbers: whole states would cost more to hand over than to compute.
    """
    figures = aided_figures(inside.aided) if is_aided else conditioned_figures(inside.seen)
    if is_aided:
        ahead_s += inside.aided.imu_lag_s  # the samples are that old
    rate_rad_s = subtract(gyr_rad_s, inside.filter.gyr_bias_rad_s)
    return motion(inside.filter, rate_rad_s, ahead_s), figures
