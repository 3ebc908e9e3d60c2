"""The core, resident in compiled memory.

The core is some two hundred numbers, with velocity aiding five hundred. To
hand them to a compiled step and take them back costs Python fifty microseconds
and more, the step itself about one. So an estimator leaves them inside and
hands over samples only; all of it can be taken out and put back at any time.
"""

import functools
from math import isfinite
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
from estimator.aiding.correction import correct_last, prediction_at
from estimator.aiding.search import EMPTY_SEARCH, add_report, add_sample
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import NO_REPORT, SIZE
from estimator.aiding.witness import compare, hear_report, watch
from estimator.arrays import Floats
from estimator.compilation.compiled import Function, compiled, inlined
from estimator.conditioning import Conditioned, ConditioningParams, condition
from estimator.conditioning.events.axis_signs import errors_squared
from estimator.conditioning.times import SPAN_S
from estimator.conditioning.vertical.rate import slow_share
from estimator.filter import kernel
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.quaternion import subtract
from estimator.live import turning
from estimator.live.aided import follow_aided, horizontal_north, is_worse
from estimator.live.conditioned import follow_conditioned
from estimator.live.core import Core, in_arrays, initial_core
from estimator.live.interval import usual_interval
from estimator.live.iron import mounted_rad, unshown_iron
from estimator.live.published import (
    OUTPUT_HORIZON_S,
    Said,
    aided_figures,
    conditioned_figures,
    motion,
    raw_figures,
    widen,
    write,
)
from estimator.live.pull import pulled
from estimator.live.refusal import FINE, NOT_LATER, fault_of
from estimator.live.rows import NO_ROWS, NOTHING_TO_SAY, Rows, reading_of
from estimator.live.settings import Settings, settings_of
from estimator.profile import load_profile
from estimator.types import NOTHING_BETWEEN, Sample, Vec3

# numba ships no types
_numba_config: Any = numba.config
_typeof: Any = numba.typeof

# Time over which e is averaged for the sigma of raw vectors: one sample's e is mostly its noise.
SIGMA_TIME_S = 1.0

# Why rows of samples end: there are no more; one is refused, see :mod:`estimator.live.refusal`;
# one has told the first heading, or left no finite attitude.
TAKEN = FINE
FIRST_HEADING = 11
NOT_FINITE_NOW = 12

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


FIELDS = ("params", "between", "rows", "said", *Core._fields)
# No arrays are laid.
NOTHING_LAID = (NO_ROWS, NOTHING_TO_SAY)


class InPython:
    """What compiled memory is in plain Python: an object with these fields."""

    def __init__(self, *values: Any) -> None:
        for name, value in zip(FIELDS, values, strict=True):
            setattr(self, name, value)


if _numba_config.DISABLE_JIT:
    Resident: Any = InPython
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


@functools.cache
def example_types() -> tuple[tuple[Any, ...], Any]:
    """The types of what :func:`resident` is called with, and of the handle that it returns."""
    settings = settings_of(load_profile("imu"))
    params, core = params_of(settings), in_arrays(initial_core(settings))
    fields = zip(FIELDS, (params, NOTHING_BETWEEN, *NOTHING_LAID, *core), strict=True)
    inside = _resident_type([(field, _typeof(value)) for field, value in fields])
    return tuple(map(_typeof, (params, core, *NOTHING_LAID))), inside


def takes_handle(function: Function) -> Function:
    """A kernel that takes a handle; :func:`arguments_with` has the types of its arguments."""
    kernel = compiled(types=lambda: arguments_with(example_types()[1])[kernel])(function)
    return kernel


@functools.cache
def arguments_with(inside: Any) -> dict[Any, tuple[Any, ...]]:
    """The types of the arguments of all kernels that take a handle, which is of type ``inside``."""
    number, flag = types.float64, types.boolean
    whole = types.int64
    report = _typeof(NO_REPORT)
    readings = (number,) * 9
    return {
        contents: (inside,),
        clock: (inside,),
        contradicted_axes: (inside,),
        advance_raw: (inside, whole, *readings, flag),
        advance: (inside, whole, *readings, flag, flag, whole, whole),
        lay: (inside, *(_typeof(value) for value in NOTHING_LAID)),
        hear_rate: (inside, whole, number, number, number),
        turn_on: (inside, whole, number, number, number),
        turning_of: (inside,),
        advance_aided: (inside, report, flag),
        hear: (inside, report),
        search: (inside, report),
        publish: (inside, whole, whole, whole),
    }


@compiled(types=lambda: example_types()[0])
def resident(params: Params, core: Core, rows: Rows, said: Floats) -> Any:
    """Put everything inside; the arrays as in :func:`lay`."""
    return Resident(
        params,
        NOTHING_BETWEEN,
        rows,
        said,
        core.time_us,
        core.usual_s,
        core.sample,
        core.filter,
        core.smooth_error,
        core.pull,
        core.conditioning,
        core.seen,
        core.search,
        core.aided,
        core.witness,
        core.covariance,
        core.velocity_history,
        core.turning,
        core.rates,
    )


@takes_handle
def contents(inside: Any) -> Core:
    """Take the core out; the covariance is a copy."""
    return Core(
        time_us=inside.time_us,
        usual_s=inside.usual_s,
        sample=inside.sample,
        filter=inside.filter,
        smooth_error=inside.smooth_error,
        pull=inside.pull,
        conditioning=inside.conditioning,
        seen=inside.seen,
        search=inside.search,
        aided=inside.aided,
        witness=inside.witness,
        covariance=inside.covariance.copy(),
        velocity_history=inside.velocity_history.copy(),
        turning=inside.turning,
        rates=inside.rates[: inside.turning.waiting].copy(),
    )


@takes_handle
def clock(inside: Any) -> tuple[int, float]:
    """Time (us) of the last sample, and the interval (s) that samples usually come at."""
    return inside.time_us, inside.usual_s


@takes_handle
def contradicted_axes(inside: Any) -> tuple[bool, bool, bool]:
    """Whether field and force contradict the gyroscope's axes x, y, z now.

    By more than a bias that the profile allows: such an error is not learnt.
    """
    axes = inside.conditioning.events.signs.axes
    is_now = axes.since_s < SPAN_S
    least = inside.params.conditioning.bias_limit_rad_s**2
    x, y, z = errors_squared(axes)
    return is_now and x > least, is_now and y > least, is_now and z > least


@takes_handle
def advance_raw(
    inside: Any,
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
    end = fault_of((gx, gy, gz), (ax, ay, az), (mx, my, mz))
    if end == FINE and time_us <= inside.time_us:
        end = NOT_LATER
    if end != FINE:
        return end
    dt_s = 1e-6 * (time_us - inside.time_us)
    sample = Sample(
        gyr_rad_s=(gx, gy, gz),
        acc_m_s2=(ax, ay, az),
        mag=(mx, my, mz),
        has_mag=has_mag,
        dt_s=dt_s,
        between=NOTHING_BETWEEN,
    )
    params = inside.params
    state = kernel.step(params.filter, params.reference, inside.filter, sample)
    before = inside.smooth_error
    inside.pull = pulled(
        inside.pull, inside.filter.q_ned_frd, state, sample.gyr_rad_s, before, dt_s
    )
    inside.smooth_error = before + dt_s / (SIGMA_TIME_S + dt_s) * (state.error - before)
    inside.filter = state
    inside.sample = sample
    inside.time_us = time_us
    inside.usual_s = usual_interval(inside.usual_s, dt_s)
    return TAKEN


@takes_handle
def advance(
    inside: Any,
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
    is_aided: bool,
    rows: int,
    standing: int,
) -> tuple[int, int, bool, Said]:
    """One conditioned sample, or as many ``rows`` of those that :func:`lay` has laid.

    ``standing`` is the compass's, see :mod:`estimator.live.iron`.

    A sample is plain numbers because those cost the least to hand over. Where it ``is_aided``
    the filter waits for :func:`advance_aided`.

    Returns how many were taken, what has ended it there, whether there is a heading by the field,
    and what there is to publish.
    """
    params = inside.params
    place_gauss = params.reference.place_gauss
    memory, seen, state = inside.conditioning, inside.seen, inside.filter
    sample, between = inside.sample, inside.between
    laid, said = inside.rows, inside.said
    last_us, usual_s = inside.time_us, inside.usual_s
    gyr, acc, mag = (gx, gy, gz), (ax, ay, az), (mx, my, mz)
    k, end = 0, TAKEN
    while end == TAKEN and k < max(1, rows):
        if rows > 0:
            time_us, gyr, acc, mag, has_mag = reading_of(laid, k)
        end = fault_of(gyr, acc, mag)
        if end == FINE and time_us <= last_us:
            end = NOT_LATER
        if end != FINE:
            break
        dt_s = 1e-6 * (time_us - last_us)
        sample = Sample(
            gyr_rad_s=gyr, acc_m_s2=acc, mag=mag, has_mag=has_mag, dt_s=dt_s, between=between
        )
        between = NOTHING_BETWEEN
        had_heading = seen.has_heading
        memory, seen = condition(params.conditioning, memory, sample)
        if seen.has_heading and not had_heading:
            end = FIRST_HEADING
        if dt_s > SPAN_S:  # how the vehicle has turned meanwhile is not known
            inside.search = EMPTY_SEARCH
        elif inside.search.window.is_open:
            vertical = memory.vertical
            inside.search = add_sample(
                inside.search, vertical.gravity.q_g_frd, acc, dt_s, vertical.tilt.missed
            )
        if not is_aided:
            state = follow_conditioned(params.filter, params.reference, state, seen, dt_s)
            q = state.q_ned_frd
            if not isfinite(q[0] + q[1] + q[2] + q[3]):
                end = NOT_FINITE_NOW
            if rows > 0:
                iron_rad = unshown_iron(params.conditioning, memory, place_gauss, standing)
                write(said[k], said_now(time_us, state, seen, gyr, iron_rad))
        last_us, usual_s = time_us, usual_interval(usual_s, dt_s)
        k += 1
    inside.conditioning = memory
    inside.seen = seen
    inside.sample = sample
    inside.time_us = last_us
    inside.usual_s = usual_s
    inside.between = between
    if not is_aided and k > 0:
        inside.filter = state
        inside.smooth_error = state.error
    iron_rad = unshown_iron(params.conditioning, memory, place_gauss, standing)
    now = said_now(last_us, state, seen, sample.gyr_rad_s, iron_rad)
    return k, end, seen.has_heading, now


@inlined
def said_now(
    time_us: int, state: FilterState, seen: Conditioned, gyr: Vec3, unshown_iron_rad: float
) -> Said:
    """What a conditioned sample without velocity leaves to be published."""
    rate = subtract(gyr, state.gyr_bias_rad_s)
    moved = motion(state, rate, 0.0, state.error, state.error_rate_1_s)
    return time_us, moved, conditioned_figures(seen, unshown_iron_rad), seen.has_heading


@takes_handle
def lay(inside: Any, rows: Rows, said: Floats) -> None:
    """Lay arrays for :func:`advance`, as in :mod:`estimator.live.rows`."""
    inside.rows = rows
    inside.said = said


@takes_handle
def hear_rate(inside: Any, time_us: int, x: float, y: float, z: float) -> bool:
    """Body rates of another messenger; whether they are kept.

    At the very times of the samples they are of use only where those are in doubt.
    """
    state = inside.turning
    if time_us < inside.time_us:
        return False
    if time_us == inside.time_us:
        a, b, c = contradicted_axes(inside)
        d, e, f = state.stands_in
        if not (a or b or c or d or e or f):
            return False
    inside.turning, inside.rates = turning.hear_rate(state, inside.rates, time_us, (x, y, z))
    return True


@takes_handle
def turn_on(
    inside: Any, time_us: int, gx: float, gy: float, gz: float
) -> tuple[bool, float, float, float]:
    """Up to the next sample, by others' rates too.

    Returns whether those show the turning up to there, and what the gyroscope reads, or what
    stands in for it.
    """
    gyr = (gx, gy, gz)
    state, between = turning.take_between(
        inside.turning, inside.rates, inside.time_us, time_us, gyr
    )
    state, (x, y, z) = turning.stand_in(state, time_us, gyr, contradicted_axes(inside))
    inside.turning = state
    if between.given:
        inside.between = between
    return between.given, x, y, z


@takes_handle
def turning_of(inside: Any) -> tuple[int, tuple[bool, bool, bool]]:
    """Steps that were integrated through others' rates, and the axes that they stand in for."""
    return inside.turning.used, inside.turning.stands_in


@takes_handle
def advance_aided(inside: Any, report: Report, knows_north: bool) -> tuple[bool, bool]:
    """The last sample with the velocity report that belongs to it, if any.

    Returns whether to go on aided, and whether velocity alone may have shown the attitude anew.

    A kernel of its own: all in one would compile the conditioning stage twice.
    """
    params = inside.params
    reference = params.reference
    seen = inside.seen
    north = horizontal_north(reference, knows_north)
    others = StepInputs(
        gravity_b=seen.gravity_b,
        gravity_sigma_rad=seen.sigma_brief_rad,
        missed=inside.conditioning.vertical.tilt.missed,
        north=north,
        place_gauss=reference.place_gauss,
    )
    aided, covariance, velocity_history = aid(
        params.aiding,
        inside.aided,
        inside.covariance,
        inside.velocity_history,
        inside.sample,
        report,
        others,
    )
    before = inside.aided.estimate.q_ned_frd
    knows_north = knows_north or rolls(params.aiding)
    state = follow_aided(params.filter, reference, inside.filter, aided, knows_north, before)
    inside.filter = state
    inside.smooth_error = state.error
    inside.aided = aided
    inside.covariance = covariance
    inside.velocity_history = velocity_history
    witness = watch(params.aiding, inside.witness, aided, inside.sample, report)
    tau_s = params.filter.rate_time_constant_s
    inside.witness = compare(witness, state.q_ned_frd, inside.sample.dt_s, tau_s)
    lost = slow_share(inside.sample.dt_s) > 0.0 and is_worse(aided, seen)
    has_shown = report.given and search_by(inside, report)
    return bool(is_credible(aided)) and not lost, has_shown


@takes_handle
def hear(inside: Any, report: Report) -> bool:
    """A report that belongs to the last sample, and comes behind it.

    Returns whether velocity alone may have shown the attitude anew.
    """
    aided, covariance = take_late_report(
        inside.params.aiding,
        inside.aided,
        inside.covariance,
        inside.velocity_history,
        inside.seen.gravity_b,
        report,
    )
    inside.aided = aided
    inside.covariance = covariance
    inside.witness = hear_report(inside.params.aiding, inside.witness, aided.estimate, report)
    return search_by(inside, report)


@functools.cache
def hearing(observe: Any) -> Any:
    """The step that takes a late report of one source, by what its report teaches.

    See :class:`estimator.aiding.sources.source.Source`.
    """

    def hear_other(inside: Any, report: Any, ago_s: float) -> None:
        """A report measured ``ago_s`` before the last sample."""
        now = prediction_at(inside.aided, inside.covariance, inside.velocity_history)
        x = np.zeros(SIZE)
        observe(inside.params.aiding, now, report, ago_s, x)
        inside.aided = correct_last(inside.aided, now, x)
        inside.covariance = now.covariance

    # the name of its file in the cache
    hear_other.__qualname__ = f"hear_other.{observe.__module__}.{observe.__qualname__}"
    return compiled(hear_other)


@takes_handle
def search(inside: Any, report: Report) -> bool:
    """A report while there is no aiding; whether it may have shown the attitude."""
    return search_by(inside, report)


@inlined
def search_by(inside: Any, report: Report) -> bool:
    """Take a report for the attitude by velocity alone; whether it may have shown that."""
    found, last = inside.search, inside.sample
    q_g_frd = inside.conditioning.vertical.gravity.q_g_frd
    if not found.window.is_open:  # nobody has followed the force until now
        found = add_sample(found, q_g_frd, last.acc_m_s2, last.dt_s, 0.0)
    found, closed = add_report(found, report, q_g_frd, inside.seen.gravity_b)
    inside.search = found
    return bool(closed)


@takes_handle
def publish(inside: Any, time_us: int, source: int, standing: int) -> Said:
    """What there is to publish at a time, turned on from the last sample if that is before it.

    ``source`` is what the filter's vectors come from, ``standing`` the compass's.
    """
    known_s = min(max(1e-6 * (time_us - inside.time_us), 0.0), OUTPUT_HORIZON_S)
    ahead_s = known_s
    error, error_rate_1_s = inside.filter.error, inside.filter.error_rate_1_s
    if source == AIDED:
        witness = inside.witness
        error, error_rate_1_s = witness.error, witness.error_rate_1_s
        place_gauss = inside.params.reference.place_gauss
        figures = aided_figures(
            inside.params.aiding,
            inside.aided,
            witness,
            place_gauss,
            inside.covariance,
            mounted_rad(standing),
        )
        ahead_s += inside.aided.estimate.imu_lag_s  # the samples are that old
    elif source == CONDITIONED:
        params, memory = inside.params, inside.conditioning
        place_gauss = params.reference.place_gauss
        iron_rad = unshown_iron(params.conditioning, memory, place_gauss, standing)
        figures = conditioned_figures(inside.seen, iron_rad)
    else:
        figures = raw_figures(inside.params.reference, inside.smooth_error, inside.pull)
    rate_rad_s = subtract(inside.sample.gyr_rad_s, inside.filter.gyr_bias_rad_s)
    figures = widen(figures, rate_rad_s, known_s)
    moved = motion(inside.filter, rate_rad_s, ahead_s, error, error_rate_1_s)
    return time_us, moved, figures, inside.seen.has_heading
