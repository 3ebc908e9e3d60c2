"""The paper's cost of many candidates on prepared signals, compiled and in parallel.

The same steps as ``estimator/kernel.py`` on ``tuning/paper_signals.py``'s
columns. The search runs on this form; results are scored with the plain one,
and a test holds the two equal to 1e-9.
"""

from math import expm1

import numba
import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled, compiled_parallel
from estimator.filter_types import PLAIN_STEP_LIMIT
from estimator.fuzzy import fuzzy_gain
from estimator.memberships import Memberships
from estimator.metrics import STEADY, TRANSIENT, TRANSIENT_WEIGHT
from estimator.quaternion import multiply, scale
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
        w = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)))
        s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0)))
    else:
        w = 1.0 - x / 182.0 * (1.0 - x / 240.0)
        w = 1.0 - x / 56.0 * (1.0 - x / 90.0 * (1.0 - x / 132.0 * w))
        w = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * w))
        s = 1.0 - x / 210.0 * (1.0 - x / 272.0)
        s = 1.0 - x / 72.0 * (1.0 - x / 110.0 * (1.0 - x / 156.0 * s))
        s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * s))
    s *= 0.5
    return (w, s * phi[0], s * phi[1], s * phi[2])


@compiled
def nearly_normalized(q: Quaternion) -> Quaternion:
    """Q / |q| for |q| within 1e-8 of 1: one Newton step, 1/|q| = (3 - |q|^2)/2."""
    f = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (f * q[0], f * q[1], f * q[2], f * q[3])


@compiled
def run_cost(
    gamma: float, tau_s: float, bound: float, k: Memberships, start: Array, steps: Array
) -> float:
    """J of one candidate on one noise seed: start (4,), steps (1401, 26).

    gamma and tau as in ``FilterParams``; ``bound`` of the bias, rad/s.
    """
    q = (start[0], start[1], start[2], start[3])
    bias = (0.0, 0.0, 0.0)
    error = 0.0
    d = 0.0
    smoothing = DT_S / (tau_s + DT_S)
    transient = 0.0
    steady = 0.0
    n = len(steps)
    for i in range(n):
        row = steps[i]
        if i > 0:
            turn = (
                row[TURN] - DT_S * bias[0],
                row[TURN + 1] - DT_S * bias[1],
                row[TURN + 2] - DT_S * bias[2],
            )
            q = nearly_normalized(multiply(q, exponential(turn)))

        w, x, y, z = q
        if i < TRANSIENT_STOP or i >= STEADY_START:
            # e = 1 - (q . q_true)^2
            c = w * row[TRUTH] + x * row[TRUTH + 1] + y * row[TRUTH + 2] + z * row[TRUTH + 3]
            if i < TRANSIENT_STOP:
                transient += 1.0 - c * c
            else:
                steady += 1.0 - c * c

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
        if i > 0:
            d += smoothing * ((e - error) / DT_S - d)
        error = e

        K = 1.0 + fuzzy_gain(k, e, d)
        g = K * DT_S
        if g * row[FASTEST] > PLAIN_STEP_LIMIT:
            g = -expm1(-g * row[FASTEST]) / row[FASTEST]
        q = multiply(q, exponential((-0.5 * g * w0, -0.5 * g * w1, -0.5 * g * w2)))
        f = 0.25 * gamma * g / K
        bias = (
            min(bound, max(-bound, bias[0] + f * w0)),
            min(bound, max(-bound, bias[1] + f * w1)),
            min(bound, max(-bound, bias[2] + f * w2)),
        )
    return TRANSIENT_WEIGHT * transient + steady


@compiled
def unpacked(k: Array) -> Memberships:
    """k1..k22 as the tuple that the fuzzy controller takes."""
    return (
        *(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10]),
        *(k[11], k[12], k[13], k[14], k[15], k[16], k[17], k[18], k[19], k[20], k[21]),
    )


@compiled
def candidate_cost(bound: float, candidate: Array, start: Array, steps: Array) -> float:
    """J of a candidate's row: k1..k22, gamma, tau."""
    return run_cost(candidate[22], candidate[23], bound, unpacked(candidate), start, steps)


@compiled
def serial_costs(bound: float, candidates: Array, start: Array, steps: Array) -> Array:
    """J (C, S) of candidates (C, 24): k1..k22, gamma, tau; on start (4,), steps (S, 1401, 26)."""
    costs = np.empty((len(candidates), len(steps)))
    for c in range(len(candidates)):
        for s in range(len(steps)):
            costs[c, s] = candidate_cost(bound, candidates[c], start, steps[s])
    return costs


@compiled_parallel
def parallel_costs(bound: float, candidates: Array, start: Array, steps: Array) -> Array:
    """:func:`serial_costs` with all runs of all candidates spread over threads."""
    seeds = len(steps)
    costs = np.empty((len(candidates), seeds))
    for run in numba.prange(len(candidates) * seeds):
        c = run // seeds
        s = run % seeds
        costs[c, s] = candidate_cost(bound, candidates[c], start, steps[s])
    return costs
