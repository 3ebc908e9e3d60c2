"""The paper's cost of many candidates on prepared signals, compiled and in parallel.

The same steps as ``estimator/filter/kernel.py`` on ``tuning/paper_signals.py``'s
columns. The search runs on this form; results are scored with the plain one,
and a test holds the two equal to 1e-9.
"""

from math import expm1, factorial
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from estimator.compilation.compiled import compiled, compiled_parallel
from estimator.filter.fuzzy import fuzzy_gain
from estimator.filter.memberships import Memberships
from estimator.filter.types import PLAIN_STEP_LIMIT
from estimator.geometry.metrics import COST_RATE_HZ, STEADY, TRANSIENT, TRANSIENT_WEIGHT
from estimator.geometry.quaternion import multiply, scale
from estimator.types import Quaternion, Vec3
from tuning.paper_signals import FASTEST, INNOVATION, TRACE, TRUTH, TURN

Array = NDArray[np.float64]

DT_S = 0.01
TRANSIENT_STOP = TRANSIENT.stop
STEADY_START = STEADY.start

# Squares of the half angle (rad^2). Below the first, four terms of the series of
# cos and sin(x)/x leave less than 1e-16; below the second, eight.
FEW_TERMS = 1e-3
MANY_TERMS = 0.5

# (-1)^n / (2n)! and (-1)^n / (2 (2n + 1)!): cos(h) and sin(h)/(2 h) in powers of h^2
C1, C2, C3, C4, C5, C6, C7, C8 = ((-1.0) ** n / factorial(2 * n) for n in range(1, 9))
S1, S2, S3, S4, S5, S6, S7, S8 = (0.5 * (-1.0) ** n / factorial(2 * n + 1) for n in range(1, 9))


@compiled
def exponential(phi: Vec3) -> Quaternion:
    """The exponential map by series, with x the square of half the angle; no library calls."""
    x = 0.25 * (phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    if x > MANY_TERMS:
        # halve and square: exp(phi) = exp(phi/2)^2
        h = series(scale(0.5, phi), 0.25 * x)
        return multiply(h, h)
    return series(phi, x)


@compiled
def series(phi: Vec3, x: float) -> Quaternion:
    """(cos h, sin(h)/(2 h) phi) with x = h^2, by as many terms as x asks for."""
    if x < FEW_TERMS:
        w = 1.0 + x * (C1 + x * (C2 + x * (C3 + x * C4)))
        s = 0.5 + x * (S1 + x * (S2 + x * (S3 + x * S4)))
    else:
        w = C4 + x * (C5 + x * (C6 + x * (C7 + x * C8)))
        w = 1.0 + x * (C1 + x * (C2 + x * (C3 + x * w)))
        s = S4 + x * (S5 + x * (S6 + x * (S7 + x * S8)))
        s = 0.5 + x * (S1 + x * (S2 + x * (S3 + x * s)))
    return (w, s * phi[0], s * phi[1], s * phi[2])


@compiled
def nearly_normalized(q: Quaternion) -> Quaternion:
    """Q / |q| for |q| within 1e-8 of 1: one Newton step, 1/|q| = (3 - |q|^2)/2."""
    f = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (f * q[0], f * q[1], f * q[2], f * q[3])


class Common(NamedTuple):
    """What all candidates share; see :class:`estimator.filter.types.FilterParams`."""

    bias_bound_rad_s: float
    first_step_s: float


class Candidate(NamedTuple):
    """What a run needs of a candidate; ``smoothing`` is dt/(tau + dt)."""

    k: Memberships
    gamma: float
    smoothing: float
    common: Common


class Run(NamedTuple):
    """The state of one run, and J as far as it goes."""

    q_ned_frd: Quaternion
    gyr_bias_rad_s: Vec3
    error: float
    error_rate_1_s: float
    cost: float


@compiled
def advance(candidate: Candidate, run: Run, steps: Array, i: int) -> Run:
    """Step i: propagate, take the true error, correct."""
    row = steps[i]
    q = run.q_ned_frd
    bias = run.gyr_bias_rad_s
    if i > 0:
        turn = (
            row[TURN] - DT_S * bias[0],
            row[TURN + 1] - DT_S * bias[1],
            row[TURN + 2] - DT_S * bias[2],
        )
        q = nearly_normalized(multiply(q, exponential(turn)))
    w, x, y, z = q
    cost = run.cost
    if i < TRANSIENT_STOP or i >= STEADY_START:
        # e = 1 - (q . q_true)^2
        c = w * row[TRUTH] + x * row[TRUTH + 1] + y * row[TRUTH + 2] + z * row[TRUTH + 3]
        weight = TRANSIENT_WEIGHT if i < TRANSIENT_STOP else 1.0
        cost += weight * (1.0 - c * c)
    r00 = 1.0 - 2.0 * (y * y + z * z)
    r01 = 2.0 * (x * y - w * z)
    r02 = 2.0 * (x * z + w * y)
    r10 = 2.0 * (x * y + w * z)
    r11 = 1.0 - 2.0 * (x * x + z * z)
    r12 = 2.0 * (y * z - w * x)
    r20 = 2.0 * (x * z - w * y)
    r21 = 2.0 * (y * z + w * x)
    r22 = 1.0 - 2.0 * (x * x + y * y)
    # antisymmetric part of R^T A
    a = INNOVATION
    w0 = (r01 * row[a + 2] + r11 * row[a + 5] + r21 * row[a + 8]) - (
        r02 * row[a + 1] + r12 * row[a + 4] + r22 * row[a + 7]
    )
    w1 = (r02 * row[a] + r12 * row[a + 3] + r22 * row[a + 6]) - (
        r00 * row[a + 2] + r10 * row[a + 5] + r20 * row[a + 8]
    )
    w2 = (r00 * row[a + 1] + r10 * row[a + 4] + r20 * row[a + 7]) - (
        r01 * row[a] + r11 * row[a + 3] + r21 * row[a + 6]
    )
    b = TRACE
    trace = (
        (r00 * row[b] + r01 * row[b + 1] + r02 * row[b + 2])
        + (r10 * row[b + 3] + r11 * row[b + 4] + r12 * row[b + 5])
        + (r20 * row[b + 6] + r21 * row[b + 7] + r22 * row[b + 8])
    )
    e = min(1.0, max(0.0, 0.25 * (3.0 - trace)))
    d = run.error_rate_1_s
    if i > 0:
        d += candidate.smoothing * ((e - run.error) * COST_RATE_HZ - d)

    K = 1.0 + fuzzy_gain(candidate.k, e, d)
    g = K * (DT_S if i > 0 else candidate.common.first_step_s)
    if g * row[FASTEST] > PLAIN_STEP_LIMIT:
        g = -expm1(-g * row[FASTEST]) / row[FASTEST]
    q = multiply(q, exponential((-0.5 * g * w0, -0.5 * g * w1, -0.5 * g * w2)))
    f = 0.25 * candidate.gamma * g / K
    bound = candidate.common.bias_bound_rad_s
    bias = (
        min(bound, max(-bound, bias[0] + f * w0)),
        min(bound, max(-bound, bias[1] + f * w1)),
        min(bound, max(-bound, bias[2] + f * w2)),
    )
    return Run(q_ned_frd=q, gyr_bias_rad_s=bias, error=e, error_rate_1_s=d, cost=cost)


@compiled
def two_costs(
    one: Candidate, two: Candidate, start: Array, steps_one: Array, steps_two: Array
) -> tuple[float, float]:
    """J of two runs, side by side: start (4,), steps (1401, 26) of each.

    A run is one long chain of operations that wait for each other; two chains
    keep the processor twice as busy.
    """
    q = (start[0], start[1], start[2], start[3])
    a = Run(q_ned_frd=q, gyr_bias_rad_s=(0.0, 0.0, 0.0), error=0.0, error_rate_1_s=0.0, cost=0.0)
    b = a
    for i in range(len(steps_one)):
        a = advance(one, a, steps_one, i)
        b = advance(two, b, steps_two, i)
    return a.cost, b.cost


@compiled
def unpack(k: Array) -> Memberships:
    """k1..k22 as the tuple that the fuzzy controller takes."""
    return (
        *(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10]),
        *(k[11], k[12], k[13], k[14], k[15], k[16], k[17], k[18], k[19], k[20], k[21]),
    )


@compiled
def candidate_of(row: Array, common: Common) -> Candidate:
    """A candidate from its row: k1..k22, gamma, tau."""
    return Candidate(unpack(row), row[22], DT_S / (row[23] + DT_S), common)


@compiled
def pair_costs(
    common: Common, candidates: Array, start: Array, steps: Array, pair: int, costs: Array
) -> None:
    """Runs number 2 pair and 2 pair + 1 of the C S runs, into ``costs`` (C, S)."""
    seeds = len(steps)
    a = 2 * pair
    b = min(a + 1, len(candidates) * seeds - 1)  # a lone last one runs twice
    one = candidate_of(candidates[a // seeds], common)
    two = candidate_of(candidates[b // seeds], common)
    both = two_costs(one, two, start, steps[a % seeds], steps[b % seeds])
    costs[a // seeds, a % seeds] = both[0]
    costs[b // seeds, b % seeds] = both[1]


@compiled
def serial_costs(common: Common, candidates: Array, start: Array, steps: Array) -> Array:
    """J (C, S) of candidates (C, 24): k1..k22, gamma, tau; on start (4,), steps (S, 1401, 26)."""
    costs = np.empty((len(candidates), len(steps)))
    for pair in range((costs.size + 1) // 2):
        pair_costs(common, candidates, start, steps, pair, costs)
    return costs


@compiled_parallel
def parallel_costs(common: Common, candidates: Array, start: Array, steps: Array) -> Array:
    """:func:`serial_costs` with all runs of all candidates spread over threads."""
    costs = np.empty((len(candidates), len(steps)))
    for pair in numba.prange((costs.size + 1) // 2):
        pair_costs(common, candidates, start, steps, pair, costs)
    return costs
