"""The paper's cost of many candidates on prepared signals, compiled and in parallel.

The same steps as ``estimator/filter/kernel.py`` on ``tuning/paper_signals.py``'s columns. The
search runs on this form; results are scored with the plain one, and a test holds the two equal
to 1e-9.

Eight candidates run at a time on one noise seed, in the vector lanes of the processor. A run is
one long chain of operations that wait for each other, but runs know nothing of each other. So
each quantity of the state is a row of ``LANES`` numbers, and all operations of a step but the fuzzy
inference are loops over the row without branches and calls, which the compiler turns into vector
instructions. All rows lie in one array: with several arrays the compiler cannot tell whether they
overlap, and does not use vector instructions at all.
No operation mixes lanes, so a candidate's cost has the same bits beside any others.
"""

from math import expm1, factorial
from typing import NamedTuple

import numba
import numpy as np

from estimator.arrays import Floats
from estimator.compilation.compiled import compiled, compiled_parallel, inlined
from estimator.filter.fuzzy import operating_gain
from estimator.filter.memberships import Memberships
from estimator.filter.types import PLAIN_STEP_LIMIT
from estimator.geometry.metrics import COST_RATE_HZ, STEADY, TRANSIENT, TRANSIENT_WEIGHT
from tuning.paper_signals import FASTEST, INNOVATION, TRACE, TRUTH, TURN

# Candidates side by side
LANES = 8

DT_S = 0.01
TRANSIENT_STOP = TRANSIENT.stop
STEADY_START = STEADY.start

# Where each quantity's row begins
QW, QX, QY, QZ, BX, BY, BZ, ERROR, RATE, COST, W0, W1, W2, G, F, SMOOTHING, PULL = (
    LANES * i for i in range(17)
)
SIZE = 17 * LANES
# Of 1 + k_op
LARGEST_GAIN = 101.0
# Columns of a candidate: k1..k22, then these
GAMMA, TAU = 22, 23


class Common(NamedTuple):
    """What all candidates share; see :class:`estimator.filter.types.FilterParams`."""

    bias_bound_rad_s: float
    first_step_s: float


# (-1)^n / (2n)! and (-1)^n / (2 (2n + 1)!): cos(h) and sin(h)/(2 h) in powers of h^2. A plain
# step turns by at most 1.6 sum s_i / (sum s_i - lambda_min) <= 2.4 rad, h^2 <= 1.44: what is left
# out after the ninth power is below 2e-17.
C = tuple((-1.0) ** n / factorial(2 * n) for n in range(10))
S = tuple(0.5 * (-1.0) ** n / factorial(2 * n + 1) for n in range(10))
C1, C2, C3, C4, C5, C6, C7, C8, C9 = C[1:]
S1, S2, S3, S4, S5, S6, S7, S8, S9 = S[1:]


@inlined
def cosine(x: float) -> float:
    """cos(h) from x = h^2 by nine powers."""
    high = C5 + x * (C6 + x * (C7 + x * (C8 + x * C9)))
    return 1.0 + x * (C1 + x * (C2 + x * (C3 + x * (C4 + x * high))))


@inlined
def half_sine(x: float) -> float:
    """sin(h)/(2 h) from x = h^2 by nine powers."""
    high = S5 + x * (S6 + x * (S7 + x * (S8 + x * S9)))
    return 0.5 + x * (S1 + x * (S2 + x * (S3 + x * (S4 + x * high))))


@inlined
def observe(state: Floats, row: Floats, is_later: float, weight: float) -> None:
    """Every lane: propagate, take the true error, compare with the vectors; innovation, e, d.

    ``is_later`` is 0 for the first sample, which nothing came before, and else 1.
    """
    turn_x, turn_y, turn_z = row[TURN], row[TURN + 1], row[TURN + 2]
    true_w, true_x, true_y, true_z = row[TRUTH], row[TRUTH + 1], row[TRUTH + 2], row[TRUTH + 3]
    a0, a1, a2 = row[INNOVATION], row[INNOVATION + 1], row[INNOVATION + 2]
    a3, a4, a5 = row[INNOVATION + 3], row[INNOVATION + 4], row[INNOVATION + 5]
    a6, a7, a8 = row[INNOVATION + 6], row[INNOVATION + 7], row[INNOVATION + 8]
    b0, b1, b2 = row[TRACE], row[TRACE + 1], row[TRACE + 2]
    b3, b4, b5 = row[TRACE + 3], row[TRACE + 4], row[TRACE + 5]
    b6, b7, b8 = row[TRACE + 6], row[TRACE + 7], row[TRACE + 8]
    for i in range(LANES):
        x = is_later * (turn_x - DT_S * state[BX + i])
        y = is_later * (turn_y - DT_S * state[BY + i])
        z = is_later * (turn_z - DT_S * state[BZ + i])
        h2 = 0.25 * (x * x + y * y + z * z)
        c, s = cosine(h2), half_sine(h2)
        x, y, z = s * x, s * y, s * z
        pw, px, py, pz = state[QW + i], state[QX + i], state[QY + i], state[QZ + i]
        w = pw * c - px * x - py * y - pz * z
        qx = pw * x + px * c + py * z - pz * y
        qy = pw * y - px * z + py * c + pz * x
        qz = pw * z + px * y - py * x + pz * c
        # Q / |q| for |q| within 1e-8 of 1: one Newton step
        f = 1.5 - 0.5 * (w * w + qx * qx + qy * qy + qz * qz)
        w, x, y, z = f * w, f * qx, f * qy, f * qz
        state[QW + i], state[QX + i], state[QY + i], state[QZ + i] = w, x, y, z
        # e = 1 - (q . q_true)^2
        c = w * true_w + x * true_x + y * true_y + z * true_z
        state[COST + i] += weight * (1.0 - c * c)
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
        state[W0 + i] = (r01 * a2 + r11 * a5 + r21 * a8) - (r02 * a1 + r12 * a4 + r22 * a7)
        state[W1 + i] = (r02 * a0 + r12 * a3 + r22 * a6) - (r00 * a2 + r10 * a5 + r20 * a8)
        state[W2 + i] = (r00 * a1 + r10 * a4 + r20 * a7) - (r01 * a0 + r11 * a3 + r21 * a6)
        trace = (
            (r00 * b0 + r01 * b1 + r02 * b2)
            + (r10 * b3 + r11 * b4 + r12 * b5)
            + (r20 * b6 + r21 * b7 + r22 * b8)
        )
        e = 0.25 * (3.0 - trace)
        e = max(0.0, e)
        e = min(1.0, e)
        d = state[RATE + i]
        state[RATE + i] = d + is_later * state[SMOOTHING + i] * (
            (e - state[ERROR + i]) * COST_RATE_HZ - d
        )
        state[ERROR + i] = e


@inlined
def choose_gains(state: Floats, rules: list[Memberships], fastest: float, step_s: float) -> None:
    """Every lane: K by its fuzzy rules, and its factors for the attitude and for the bias."""
    for i in range(LANES):
        K = 1.0 + operating_gain(rules[i], state[ERROR + i], state[RATE + i])
        state[G + i] = -0.5 * step_s * K
        state[F + i] = step_s * state[PULL + i]
    if LARGEST_GAIN * step_s * fastest > PLAIN_STEP_LIMIT:
        shorten_steps(state, fastest)


@inlined
def shorten_steps(state: Floats, fastest: float) -> None:
    """Lane by lane: the exact decay in place of a step that is too long."""
    for i in range(LANES):
        g = -2.0 * state[G + i]
        if g * fastest > PLAIN_STEP_LIMIT:
            short = -expm1(-g * fastest) / fastest
            state[G + i] = -0.5 * short
            state[F + i] *= short / g


@inlined
def turn_back(state: Floats, bound: float) -> None:
    """Every lane: the correction of attitude and bias."""
    for i in range(LANES):
        g, f = state[G + i], state[F + i]
        x, y, z = state[W0 + i], state[W1 + i], state[W2 + i]
        bx, by, bz = state[BX + i] + f * x, state[BY + i] + f * y, state[BZ + i] + f * z
        bx, by, bz = max(-bound, bx), max(-bound, by), max(-bound, bz)
        state[BX + i], state[BY + i], state[BZ + i] = min(bound, bx), min(bound, by), min(bound, bz)
        x, y, z = g * x, g * y, g * z
        h2 = 0.25 * (x * x + y * y + z * z)
        c, s = cosine(h2), half_sine(h2)
        x, y, z = s * x, s * y, s * z
        pw, px, py, pz = state[QW + i], state[QX + i], state[QY + i], state[QZ + i]
        state[QW + i] = pw * c - px * x - py * y - pz * z
        state[QX + i] = pw * x + px * c + py * z - pz * y
        state[QY + i] = pw * y - px * z + py * c + pz * x
        state[QZ + i] = pw * z + px * y - py * x + pz * c


@inlined
def unpack(k: Floats) -> Memberships:
    """k1..k22 as the tuple that the fuzzy controller takes."""
    return (
        *(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10]),
        *(k[11], k[12], k[13], k[14], k[15], k[16], k[17], k[18], k[19], k[20], k[21]),
    )


@compiled
def lane_costs(common: Common, candidates: Floats, start: Floats, steps: Floats) -> Floats:
    """J (8,) of candidates (8, 24): k1..k22, gamma, tau; on start (4,), steps (1401, 26)."""
    state = np.zeros(SIZE)
    for i in range(LANES):
        state[QW + i], state[QX + i], state[QY + i], state[QZ + i] = start
        state[SMOOTHING + i] = DT_S / (candidates[i, TAU] + DT_S)
        state[PULL + i] = 0.25 * candidates[i, GAMMA]
    rules = [unpack(candidates[i]) for i in range(LANES)]
    for k in range(len(steps)):
        weight = TRANSIENT_WEIGHT if k < TRANSIENT_STOP else 1.0 if k >= STEADY_START else 0.0
        observe(state, steps[k], 1.0 if k > 0 else 0.0, weight)
        choose_gains(state, rules, steps[k, FASTEST], DT_S if k > 0 else common.first_step_s)
        turn_back(state, common.bias_bound_rad_s)
    return state[COST : COST + LANES].copy()


@compiled
def fill_costs(
    common: Common, candidates: Floats, start: Floats, steps: Floats, number: int, costs: Floats
) -> None:
    """Group ``number`` of eight candidates, seed after seed, into ``costs`` (C, S)."""
    seeds = len(steps)
    first = LANES * (number // seeds)
    seed = number % seeds
    group = np.empty((LANES, candidates.shape[1]))
    for i in range(LANES):  # the last group is filled up with its last candidate
        group[i] = candidates[min(first + i, len(candidates) - 1)]
    found = lane_costs(common, group, start, steps[seed])
    for i in range(min(LANES, len(candidates) - first)):
        costs[first + i, seed] = found[i]


@compiled
def serial_costs(common: Common, candidates: Floats, start: Floats, steps: Floats) -> Floats:
    """J (C, S) of candidates (C, 24): k1..k22, gamma, tau; on start (4,), steps (S, 1401, 26)."""
    costs = np.empty((len(candidates), len(steps)))
    groups = (len(candidates) + LANES - 1) // LANES
    for number in range(groups * len(steps)):
        fill_costs(common, candidates, start, steps, number, costs)
    return costs


@compiled_parallel
def parallel_costs(common: Common, candidates: Floats, start: Floats, steps: Floats) -> Floats:
    """:func:`serial_costs` with all groups spread over threads."""
    costs = np.empty((len(candidates), len(steps)))
    groups = (len(candidates) + LANES - 1) // LANES
    for number in numba.prange(groups * len(steps)):
        fill_costs(common, candidates, start, steps, number, costs)
    return costs
