"""The cost of candidates on recorded flights, by the steps of the live filter's kernels."""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from estimator.compilation.compiled import compiled, compiled_parallel
from estimator.conditioning.condition import condition, initial_state
from estimator.conditioning.types import Conditioned
from estimator.filter.kernel import correct, integrate_rate
from estimator.filter.observation import ReferenceParams, weighted_vectors
from estimator.filter.types import FilterParams, FilterState
from estimator.filter.types import initial_state as filter_state
from estimator.geometry.quaternion import (
    conjugate,
    dot,
    exp,
    multiply,
    normalize,
    normalized_distance,
    rotate,
    rotate_inverse,
    scale,
    unit,
)
from estimator.types import IDENTITY, NOTHING_BETWEEN, ZERO_VEC3, Quaternion, Sample, Vec3
from tuning.paper_kernel import unpack

Array = NDArray[np.float64]

# What happens at a sample (bits of ``what``)
START = 1  # a segment begins: the estimate is set wrong
RESTART = 2  # nothing from before holds
RESYNC = 4  # a prediction begins anew from the estimate
# Which error counts (bits of ``what``; with neither, that of the whole attitude)
INCLINATION = 8
PREDICTION = 16

# Columns of a candidate's row, after k1..k22; from GAMMA on they are the same for all candidates
TAU = 22
S_GRAVITY = 23
S_MAGNETIC = 24
S_CROSS = 25
GAMMA = 26
BIAS_BOUND = 27
EULER_STEP_MAX = 28
GRAVITY_NED = 29
GAIN_IS_FIXED = 32  # 1 or 0, as GAIN_KNOWS_NOISE
FIXED_GAIN = 33
GAIN_KNOWS_NOISE = 34
COLUMNS = 35


class Recorded(NamedTuple):
    """N samples in sequence, of any number of logs; directions and attitudes as in ``types``."""

    what: NDArray[np.int64]
    dt_s: Array
    gyr_rad_s: Array  # (N, 3)
    acc_m_s2: Array  # (N, 3)
    mag: Array  # (N, 3)
    has_mag: NDArray[np.bool_]
    magnetic_ned: Array  # (N, 3), true north turned by the log's declination
    truth: Array  # (N, 4)
    start: Array  # (N, 4), the wrong attitude where a segment starts
    weight: Array  # of the error in the cost


class Prepared(NamedTuple):
    """The conditioning stage's answers at the same samples, for candidates that share it."""

    rate_rad_s: Array  # (N, 3)
    gravity_b: Array  # (N, 3)
    magnetic_b: Array  # (N, 3)
    weight: Array  # (N,), of both vectors against the gyroscope
    magnetic_share: Array  # (N,), 0 where there is no heading


class Seen(NamedTuple):
    """What the filter takes of one conditioned sample."""

    rate_rad_s: Vec3
    gravity_b: Vec3
    magnetic_b: Vec3
    weight: float
    magnetic_share: float


class Run(NamedTuple):
    """The filter, the gyroscope's prediction ``ahead`` of it, the last error e, the cost so far."""

    state: FilterState
    ahead: Quaternion
    error: float
    cost: float


# The conditioning's state before the first sample, for any object with its parameters' names.
blank_state: Any = compiled(initial_state)
blank_filter: Any = compiled(filter_state)


@compiled
def vec3(a: Array, i: int) -> Vec3:
    """Row i of (N, 3)."""
    return (a[i, 0], a[i, 1], a[i, 2])


@compiled
def quaternion(a: Array, i: int) -> Quaternion:
    """Row i of (N, 4)."""
    return (a[i, 0], a[i, 1], a[i, 2], a[i, 3])


@compiled
def sample_of(data: Recorded, i: int) -> Sample:
    """What the conditioning stage takes of sample i."""
    return Sample(
        gyr_rad_s=vec3(data.gyr_rad_s, i),
        acc_m_s2=vec3(data.acc_m_s2, i),
        mag=vec3(data.mag, i),
        has_mag=data.has_mag[i],
        dt_s=data.dt_s[i],
        between=NOTHING_BETWEEN,
    )


@compiled
def inclination_distance(p: Quaternion, q: Quaternion) -> float:
    """sin^2 of half the inclination error: the part of the normalised distance about level axes."""
    d = multiply(p, conjugate(q))
    return min(1.0, d[1] * d[1] + d[2] * d[2])


@compiled
def prediction_error(
    q: Quaternion, gravity_ned: Vec3, acc: Vec3, magnetic_ned: Vec3, mag: Vec3, has_mag: bool
) -> float:
    """sin^2 of half the angle between predicted and measured vectors.

    The mean over gravity and, where there is a field, its horizontal direction.
    """
    e = 0.5 * (1.0 + dot(rotate_inverse(q, gravity_ned), unit(acc)))
    if has_mag:
        field = rotate(q, mag)
        horizontal = unit((field[0], field[1], 0.0))
        e = 0.5 * e + 0.25 * (1.0 - dot(horizontal, magnetic_ned))
    return e


@compiled
def advance(row: Array, data: Recorded, i: int, seen: Seen, run: Run) -> Run:
    """One sample: propagate, correct, score; or set the estimate wrong where a segment starts."""
    params = FilterParams(
        gamma=row[GAMMA],
        bias_bound_rad_s=row[BIAS_BOUND],
        rate_time_constant_s=row[TAU],
        euler_step_max_s=row[EULER_STEP_MAX],
        first_step_s=0.0,  # a segment's first sample has others before it
        memberships=unpack(row),
        gain_is_fixed=row[GAIN_IS_FIXED] > 0.0,
        fixed_gain=row[FIXED_GAIN],
        gain_knows_noise=row[GAIN_KNOWS_NOISE] > 0.0,
    )
    gravity_ned = (row[GRAVITY_NED], row[GRAVITY_NED + 1], row[GRAVITY_NED + 2])
    dt = data.dt_s[i]
    what = data.what[i]
    magnetic_ned = vec3(data.magnetic_ned, i)
    reference = ReferenceParams(
        magnetic_ned=magnetic_ned,
        gravity_ned=gravity_ned,
        s_magnetic=row[S_MAGNETIC],
        s_gravity=row[S_GRAVITY],
        s_cross=row[S_CROSS],
    )
    vectors = weighted_vectors(
        reference,
        magnetic_frd=seen.magnetic_b,
        magnetic_share=seen.magnetic_share,
        gravity_frd=seen.gravity_b,
        gravity_share=1.0,
        weight=seen.weight,
    )
    if what & START:
        wrong = blank_filter(quaternion(data.start, i), ZERO_VEC3)
        state = correct(params, wrong, vectors, 0.0)
        ahead = state.q_ned_frd
    else:
        state = integrate_rate(run.state, seen.rate_rad_s, dt, ZERO_VEC3)
        state = correct(params, state, vectors, dt)
        ahead = normalize(multiply(run.ahead, exp(scale(dt, seen.rate_rad_s))))
    if what & PREDICTION:
        acc, mag = vec3(data.acc_m_s2, i), vec3(data.mag, i)
        e = prediction_error(ahead, gravity_ned, acc, magnetic_ned, mag, data.has_mag[i])
    elif what & INCLINATION:
        e = inclination_distance(state.q_ned_frd, quaternion(data.truth, i))
    else:
        e = normalized_distance(quaternion(data.truth, i), state.q_ned_frd)
    if what & RESYNC:
        ahead = state.q_ned_frd
    # a sample without a reference weighs nothing, whatever its e
    return Run(state, ahead, e, run.cost + data.weight[i] * e)


@compiled
def blank_run() -> Run:
    """The state before the first sample."""
    return Run(blank_filter(IDENTITY, ZERO_VEC3), IDENTITY, 0.0, 0.0)


@compiled
def filter_input(seen: Conditioned) -> Seen:
    """The part of the conditioning stage's answer that the filter takes."""
    return Seen(
        rate_rad_s=seen.rate_rad_s,
        gravity_b=seen.gravity_b,
        magnetic_b=seen.magnetic_b,
        weight=seen.weight,
        magnetic_share=1.0 if seen.has_heading else 0.0,
    )


@compiled
def prepared_input(prepared: Prepared, i: int) -> Seen:
    """What the filter takes of sample i, which was conditioned beforehand."""
    return Seen(
        rate_rad_s=vec3(prepared.rate_rad_s, i),
        gravity_b=vec3(prepared.gravity_b, i),
        magnetic_b=vec3(prepared.magnetic_b, i),
        weight=prepared.weight[i],
        magnetic_share=prepared.magnetic_share[i],
    )


@compiled
def conditioned_cost(row: Array, conditioning: Any, data: Recorded) -> float:
    """Cost of a candidate's row with its own conditioning, over all samples."""
    run = blank_run()
    blank = blank_state(conditioning)
    memory = blank
    for i in range(len(data.dt_s)):
        if data.what[i] & RESTART:
            memory = blank
        memory, seen = condition(conditioning, memory, sample_of(data, i))
        run = advance(row, data, i, filter_input(seen), run)
    return run.cost


@compiled
def prepared_cost(row: Array, prepared: Prepared, data: Recorded) -> float:
    """Cost of a candidate's row on vectors that the candidates share."""
    run = blank_run()
    for i in range(len(data.dt_s)):
        run = advance(row, data, i, prepared_input(prepared, i), run)
    return run.cost


@compiled
def prepared_errors(row: Array, prepared: Prepared, data: Recorded) -> Array:
    """e (N,) at each sample, to be drawn."""
    errors = np.empty(len(data.dt_s))
    run = blank_run()
    for i in range(len(data.dt_s)):
        run = advance(row, data, i, prepared_input(prepared, i), run)
        errors[i] = run.error
    return errors


@compiled
def prepare(conditioning: Any, data: Recorded) -> Prepared:
    """Run the conditioning stage alone over all samples."""
    blank = blank_state(conditioning)
    n = len(data.dt_s)
    out = Prepared(
        rate_rad_s=np.empty((n, 3)),
        gravity_b=np.empty((n, 3)),
        magnetic_b=np.empty((n, 3)),
        weight=np.empty(n),
        magnetic_share=np.empty(n),
    )
    memory = blank
    for i in range(n):
        if data.what[i] & RESTART:
            memory = blank
        memory, answer = condition(conditioning, memory, sample_of(data, i))
        seen = filter_input(answer)
        for j in range(3):
            out.rate_rad_s[i, j] = seen.rate_rad_s[j]
            out.gravity_b[i, j] = seen.gravity_b[j]
            out.magnetic_b[i, j] = seen.magnetic_b[j]
        out.weight[i] = seen.weight
        out.magnetic_share[i] = seen.magnetic_share
    return out


@compiled
def serial_prepared_costs(rows: Array, prepared: Prepared, data: Recorded) -> Array:
    """Costs (C,) of candidates' rows (C, 35) on shared vectors."""
    costs = np.empty(len(rows))
    for c in range(len(rows)):
        costs[c] = prepared_cost(rows[c], prepared, data)
    return costs


@compiled_parallel
def parallel_prepared_costs(rows: Array, prepared: Prepared, data: Recorded) -> Array:
    """:func:`serial_prepared_costs`, candidates spread over threads."""
    costs = np.empty(len(rows))
    for c in numba.prange(len(rows)):
        costs[c] = prepared_cost(rows[c], prepared, data)
    return costs


@compiled
def serial_conditioned_costs(rows: Array, conditioning: Any, data: Recorded) -> Array:
    """Costs (C,) of rows (C, 35), each with its record (C,) of conditioning parameters."""
    costs = np.empty(len(rows))
    for c in range(len(rows)):
        costs[c] = conditioned_cost(rows[c], conditioning[c], data)
    return costs


@compiled_parallel
def parallel_conditioned_costs(rows: Array, conditioning: Any, data: Recorded) -> Array:
    """:func:`serial_conditioned_costs`, candidates spread over threads."""
    costs = np.empty(len(rows))
    for c in numba.prange(len(rows)):
        costs[c] = conditioned_cost(rows[c], conditioning[c], data)
    return costs
