"""The core, resident in compiled memory.

The core is some two hundred numbers, with velocity aiding five hundred. To
hand them to a compiled step and take them back costs Python fifty microseconds
and more, the step itself about one. So an estimator leaves them inside and
hands over samples only; all of it can be taken out and put back at any time.
"""

from typing import Any, NamedTuple

import numba
from numba.core import types
from numba.experimental import structref

from estimator.aiding import (
    AidingParams,
    Report,
    Surroundings,
    aid,
    is_credible,
    take_late_report,
)
from estimator.aiding.search import EMPTY_SEARCH, add_report, add_sample
from estimator.aiding.types import NO_REPORT
from estimator.aiding.witness import compare, hear_report, watch
from estimator.compilation.compiled import compiled
from estimator.conditioning.condition import condition
from estimator.conditioning.rate import slow_share
from estimator.conditioning.tilt import HOLE_S
from estimator.conditioning.types import ConditioningParams
from estimator.filter import kernel
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams
from estimator.geometry.quaternion import subtract
from estimator.live.aided import follow_aided, horizontal_north, is_worse
from estimator.live.conditioned import follow_conditioned
from estimator.live.core import Core, flat, in_rows, square
from estimator.live.published import (
    Figures,
    Motion,
    aided_figures,
    conditioned_figures,
    motion,
    raw_figures,
    widen,
)
from estimator.live.settings import Settings
from estimator.types import NOTHING_BETWEEN, ZERO_VEC3, Between, Sample, Vec3

# numba ships no types
_numba_config: Any = numba.config
_typeof: Any = numba.typeof

# Time over which e is averaged for the sigma of raw vectors: one sample's e is mostly its noise.
SIGMA_TIME_S = 1.0

# What a sample has said about the heading by the field.
NO_HEADING = 0
HEADING = 1
FIRST_HEADING = 2

# What the filter's vectors come from.
RAW = 0
CONDITIONED = 1
AIDED = 2


class Params(NamedTuple):
    """What the compiled steps take from the profile."""

    filter: FilterParams
    reference: ReferenceParams
    conditioning: ConditioningParams
    aiding: AidingParams


FIELDS = ("params", *Core._fields)

if _numba_config.DISABLE_JIT:

    class Resident:
        """The same in plain Python."""

        def __init__(self, *values: Any) -> None:
            for name, value in zip(FIELDS, values, strict=True):
                setattr(self, name, value)

else:

    class Resident(structref.StructRefProxy):  # type: ignore[no-redef]
        """A handle on ``params`` and the fields of a :class:`Core`; made by :func:`resident`."""

    @structref.register
    class ResidentType(types.StructRef):
        """How numba sees it."""

    _structref: Any = structref
    _resident_type: Any = ResidentType
    _structref.define_boxing(ResidentType, Resident)
    _structref.define_constructor(Resident, ResidentType, list(FIELDS))


def params_of(settings: Settings) -> Params:
    """What the kernels take of the settings."""
    return Params(settings.filter, settings.reference, settings.conditioning, settings.aiding)


def arguments_of(settings: Settings, core: Core) -> dict[Any, tuple[Any, ...]]:
    """What numba calls the types that each kernel here is called with; not in plain Python."""
    values = (params_of(settings), in_arrays(core))
    fields = zip(FIELDS, (values[0], *values[1]), strict=True)
    inside = _resident_type([(name, _typeof(value)) for name, value in fields])
    vector, number, flag = _typeof(ZERO_VEC3), types.float64, types.boolean
    readings = (vector, vector, vector, flag, number)
    report = _typeof(NO_REPORT)
    return {
        resident: tuple(_typeof(value) for value in values),
        contents: (inside,),
        advance_raw: (inside, *readings),
        advance: (inside, *readings, _typeof(NOTHING_BETWEEN), flag),
        advance_aided: (inside, report, flag),
        hear: (inside, report),
        search: (inside, report),
        publish: (inside, number, types.intp),
    }


def in_arrays(core: Core) -> Core:
    """A snapshot's core as compiled memory holds it."""
    return core._replace(covariance=square(core.covariance), trail=in_rows(core.trail))


class Holder:
    """A core: in compiled memory from its first step on, a tuple whenever it is asked for."""

    def __init__(self, settings: Settings, core: Core) -> None:
        self._params = params_of(settings)
        self._core = core
        self._inside: Any = None

    @property
    def core(self) -> Core:
        """The core as it is now."""
        if self._inside is None:
            return self._core
        core: Core = contents(self._inside)
        return core._replace(covariance=flat(core.covariance), trail=flat(core.trail))

    @property
    def inside(self) -> Any:
        """The handle that the compiled steps take."""
        if self._inside is None:
            self._inside = resident(self._params, in_arrays(self._core))
        return self._inside


@compiled
def resident(params: Params, core: Core) -> Any:
    """Put everything inside."""
    return Resident(
        params,
        core.sample,
        core.filter,
        core.smooth_error,
        core.conditioning,
        core.seen,
        core.search,
        core.aided,
        core.witness,
        core.covariance,
        core.trail,
    )


@compiled
def contents(inside: Any) -> Core:
    """Take the core out; the covariance is a copy."""
    return Core(
        sample=inside.sample,
        filter=inside.filter,
        smooth_error=inside.smooth_error,
        conditioning=inside.conditioning,
        seen=inside.seen,
        search=inside.search,
        aided=inside.aided,
        witness=inside.witness,
        covariance=inside.covariance.copy(),
        trail=inside.trail.copy(),
    )


@compiled
def advance_raw(
    inside: Any, gyr_rad_s: Vec3, acc_m_s2: Vec3, mag: Vec3, has_mag: bool, dt_s: float
) -> None:
    """One sample of raw vectors, ``dt_s`` after the one before."""
    sample = Sample(
        gyr_rad_s=gyr_rad_s,
        acc_m_s2=acc_m_s2,
        mag=mag,
        has_mag=has_mag,
        dt_s=dt_s,
        between=NOTHING_BETWEEN,
    )
    params = inside.params
    state = kernel.step(params.filter, params.reference, inside.filter, sample)
    before = inside.smooth_error
    inside.smooth_error = before + dt_s / (SIGMA_TIME_S + dt_s) * (state.error - before)
    inside.filter = state
    inside.sample = sample


@compiled
def advance(
    inside: Any,
    gyr_rad_s: Vec3,
    acc_m_s2: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt_s: float,
    between: Between,
    is_aided: bool,
) -> int:
    """One conditioned sample, ``dt_s`` after the one before; what it says about the heading.

    Where it ``is_aided`` the filter waits for :func:`advance_aided`.
    """
    sample = Sample(
        gyr_rad_s=gyr_rad_s,
        acc_m_s2=acc_m_s2,
        mag=mag,
        has_mag=has_mag,
        dt_s=dt_s,
        between=between,
    )
    inside.sample = sample
    had_heading = inside.seen.has_heading
    params = inside.params
    memory, seen = condition(params.conditioning, inside.conditioning, sample)
    inside.conditioning = memory
    inside.seen = seen
    if not is_aided:
        state = follow_conditioned(params.filter, params.reference, inside.filter, seen, dt_s)
        inside.filter = state
        inside.smooth_error = state.error
        if dt_s > HOLE_S:  # how the vehicle has turned meanwhile is not known
            inside.search = EMPTY_SEARCH
        else:
            inside.search = add_sample(inside.search, memory.gravity.q_g_frd, acc_m_s2, dt_s)
    if not seen.has_heading:
        return NO_HEADING
    return HEADING if had_heading else FIRST_HEADING


@compiled
def advance_aided(inside: Any, report: Report, knows_north: bool) -> bool:
    """The last sample with the velocity report that belongs to it, if any; whether to go on aided.

    A kernel of its own: all in one would compile the conditioning stage twice.
    """
    params = inside.params
    reference = params.reference
    seen = inside.seen
    north = horizontal_north(reference, knows_north)
    others = Surroundings(seen.gravity_b, seen.sigma_inclination_rad, north)
    aided, covariance, trail = aid(
        params.aiding, inside.aided, inside.covariance, inside.trail, inside.sample, report, others
    )
    before = inside.aided.estimate.q_ned_frd
    state = follow_aided(params.filter, reference, inside.filter, aided, knows_north, before)
    inside.filter = state
    inside.smooth_error = state.error
    inside.aided = aided
    inside.covariance = covariance
    inside.trail = trail
    witness = watch(inside.witness, aided, inside.sample, report)
    tau_s = params.filter.rate_time_constant_s
    inside.witness = compare(witness, state.q_ned_frd, inside.sample.dt_s, tau_s)
    lost = slow_share(inside.sample.dt_s) > 0.0 and is_worse(aided, seen)
    return bool(is_credible(params.aiding, aided)) and not lost


@compiled
def hear(inside: Any, report: Report) -> None:
    """A report that belongs to the last sample, and comes behind it."""
    aided, covariance = take_late_report(
        inside.params.aiding,
        inside.aided,
        inside.covariance,
        inside.trail,
        inside.seen.gravity_b,
        report,
    )
    inside.aided = aided
    inside.covariance = covariance
    inside.witness = hear_report(inside.witness, aided.estimate, report)


@compiled
def search(inside: Any, report: Report) -> bool:
    """A report while there is no aiding; whether it may have shown the attitude."""
    found, closed = add_report(inside.search, report, inside.params.aiding.receiver_lag_s)
    inside.search = found
    return closed


@compiled
def publish(inside: Any, ahead_s: float, source: int) -> tuple[Motion, Figures, bool]:
    """What there is to publish, turned ``ahead_s`` beyond the last sample.

    ``source`` is what the filter's vectors come from. The last value tells whether the field
    has told a heading. Some twenty numbers: a whole core would cost more to hand over than
    to compute.
    """
    known_s = ahead_s
    error, error_rate_1_s = inside.filter.error, inside.filter.error_rate_1_s
    if source == AIDED:
        witness = inside.witness
        error, error_rate_1_s = witness.error, witness.error_rate_1_s
        figures = aided_figures(inside.aided, witness)
        ahead_s += inside.aided.estimate.imu_lag_s  # the samples are that old
    elif source == CONDITIONED:
        figures = conditioned_figures(inside.seen)
    else:
        figures = raw_figures(inside.params.reference, inside.smooth_error)
    rate_rad_s = subtract(inside.sample.gyr_rad_s, inside.filter.gyr_bias_rad_s)
    figures = widen(figures, rate_rad_s, known_s)
    moved = motion(inside.filter, rate_rad_s, ahead_s, error, error_rate_1_s)
    return moved, figures, inside.seen.has_heading
