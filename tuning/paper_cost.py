"""The paper's cost of many candidates, by the live filter's own functions.

Eight candidates go through each step side by side, as rows of one array, so that the compiler
computes several at once. What differs from the live filter is the turn's exponential, without a
branch, and that the angle between both reference vectors is taken once.
"""

from functools import cache
from math import factorial
from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import simulate
from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.filter import kernel
from estimator.filter.fuzzy import centroid, fire, fuzzify
from estimator.filter.memberships import Memberships, fuzzy_sets
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY, TRANSIENT
from estimator.geometry.metrics import TRANSIENT_WEIGHT as WEIGHT
from estimator.geometry.quaternion import (
    SERIES_HALF_ANGLE_RAD,
    add,
    cross,
    dot,
    inverse_root,
    multiply,
    norm,
    normalized_distance,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.geometry.rotations import unit
from estimator.types import Floats, Quaternion, Vec3

DT_S = 1.0 / COST_RATE_HZ
SLOW_RAD_S = 2.0 * SERIES_HALF_ANGLE_RAD / DT_S
# J ends at t = 14 s, the signals at 15 s
SCORED_SAMPLES = STEADY.stop
TRANSIENT_STOP, STEADY_START = TRANSIENT.stop, STEADY.start
LANES = 8
# Rows of the array: k1..k22, gamma, tau of each candidate, then what changes from step to step.
GAMMA, TAU = 22, 23
Q, BIAS, ERROR, RATE, STEP, LEARNT, INNOVATION, TOTAL, ROWS = 24, 28, 31, 32, 33, 34, 35, 38, 39
# Factors of the series of the cosine, and of the sine over its angle, in its square: exact to
# rounding up to 1 rad, the first few up to SERIES_HALF_ANGLE_RAD.
FEW, ALL = 4, 9
COSINE = tuple((-1) ** n / factorial(2 * n) for n in range(ALL))
SINE = tuple((-1) ** n / factorial(2 * n + 1) for n in range(ALL))


class Signals(NamedTuple):
    """The paper's signals with the noise of S seeds, and the truth (S, 1401, 4).

    Rates, and the unit vectors of the readings of field and gravity: (S, 1401, 3).
    """

    gyr_rad_s: Floats
    magnetic: Floats
    gravity: Floats
    q_ned_frd: Floats


EXAMPLE = Signals(*(np.zeros((1, 1, 3)),) * 3, np.zeros((1, 1, 4)))


class Step(NamedTuple):
    """What all candidates meet at a sample: readings, truth, weight of e, both steps in time.

    ``across`` is v1 x v2, ``inverse`` one over its length, ``share`` that over the reference's.
    ``is_slow`` is where no candidate turns far in a step, whatever its bias.
    """

    gyr_rad_s: Vec3
    v1: Vec3
    v2: Vec3
    truth: Quaternion
    weight: float
    turned_s: float
    corrected_s: float
    across: Vec3
    inverse: float
    share: float
    fastest: float
    is_slow: bool


@cache
def paper_signals(seeds: tuple[int, ...]) -> Signals:
    """The signals up to the last sample that counts."""
    runs = [simulate(seed, COST_SAMPLES) for seed in seeds]
    gyr, mag, acc, q = (
        np.array([getattr(run, name)[:SCORED_SAMPLES] for run in runs])
        for name in ("gyr_rad_s", "mag_gauss", "acc_m_s2", "q_ned_frd")
    )
    return Signals(gyr, unit(mag), unit(-acc), q)


@compiled(types=lambda: types_of(*kernel.paper_arguments(), np.zeros((1, 24)), EXAMPLE))
def costs(
    params: FilterParams,
    reference: ReferenceParams,
    start: FilterState,
    candidates: Floats,
    signals: Signals,
) -> Floats:
    """J (C, S) of Eq. (15), "Cost_function", of k1..k22, gamma, tau (C, 24) on every seed.

    Both vectors need a confidence above zero.
    """
    found = np.empty((len(candidates), len(signals.gravity)))
    lanes = np.empty((ROWS, LANES))
    for first in range(0, len(candidates), LANES):
        for j in range(LANES):
            lanes[:Q, j] = candidates[min(first + j, len(candidates) - 1)]
        for seed in range(len(signals.gravity)):
            lanes[Q:] = 0.0
            for i in range(4):
                lanes[Q + i] = start.q_ned_frd[i]
            for k in range(SCORED_SAMPLES):
                step = _step(params, reference, signals, seed, k)
                if step.is_slow:
                    _compare(reference, step, lanes, FEW)
                else:
                    _compare(reference, step, lanes, ALL)
                _infer(params, step, lanes)
                _correct(params.bias_bound_rad_s, lanes)
            for j in range(min(LANES, len(candidates) - first)):
                found[first + j, seed] = lanes[TOTAL, j]
    return found


@inlined
def _step(
    params: FilterParams, reference: ReferenceParams, signals: Signals, seed: int, k: int
) -> Step:
    s1, s2, s3 = reference.s_magnetic, reference.s_gravity, reference.s_cross
    v1, v2 = _vector(signals.magnetic[seed, k]), _vector(signals.gravity[seed, k])
    gyr = _vector(signals.gyr_rad_s[seed, k])
    across, apart = cross(v1, v2), cross(reference.magnetic_ned, reference.gravity_ned)
    inverse, q = inverse_root(dot(across, across)), signals.q_ned_frd[seed, k]
    return Step(
        gyr_rad_s=gyr,
        v1=v1,
        v2=v2,
        truth=(q[0], q[1], q[2], q[3]),
        weight=WEIGHT if k < TRANSIENT_STOP else 1.0 if k >= STEADY_START else 0.0,
        turned_s=DT_S if k > 0 else 0.0,
        corrected_s=DT_S if k > 0 else params.first_step_s,
        across=across,
        inverse=inverse,
        share=inverse * inverse_root(dot(apart, apart)),
        fastest=kernel.largest_rate(dot(v1, v2), s1, s2, s3),
        is_slow=norm(gyr) + 2.0 * params.bias_bound_rad_s < SLOW_RAD_S,
    )


@inlined
def _compare(reference: ReferenceParams, step: Step, lanes: Floats, terms: int) -> None:
    """Turn on, score, and compare what is seen with what is expected."""
    s1, s2, s3 = reference.s_magnetic, reference.s_gravity, reference.s_cross
    is_first = step.turned_s == 0.0
    for j in range(LANES):
        bias = (lanes[BIAS, j], lanes[BIAS + 1, j], lanes[BIAS + 2, j])
        q = (lanes[Q, j], lanes[Q + 1, j], lanes[Q + 2, j], lanes[Q + 3, j])
        q = _turned(q, scale(step.turned_s, subtract(step.gyr_rad_s, bias)), terms)
        lanes[TOTAL, j] += step.weight * normalized_distance(step.truth, q)
        u1 = rotate_inverse(q, reference.magnetic_ned)
        u2 = rotate_inverse(q, reference.gravity_ned)
        w = kernel.innovation(step.v1, u1, s1, step.v2, u2, s2)
        across = cross(u1, u2)
        w = add(w, scale(0.5 * s3 * step.share, cross(across, step.across)))
        cosine = step.share * dot(step.across, across)
        e = kernel.attitude_error(step.v1, step.v2, u1, u2, step.across, step.inverse, cosine)
        rate = kernel.follow_rate(lanes[RATE, j], e - lanes[ERROR, j], DT_S, lanes[TAU, j])
        lanes[RATE, j] = 0.0 if is_first else rate
        lanes[ERROR, j] = e
        lanes[Q, j], lanes[Q + 1, j], lanes[Q + 2, j], lanes[Q + 3, j] = q
        lanes[INNOVATION, j], lanes[INNOVATION + 1, j], lanes[INNOVATION + 2, j] = w


@inlined
def _infer(params: FilterParams, step: Step, lanes: Floats) -> None:
    """K = 1 + k_op, and the steps of attitude and bias by it; here each candidate has its way."""
    dt = step.corrected_s
    for j in range(LANES):
        k = unpack(lanes, j)
        e = fuzzify(k, lanes[ERROR, j])
        rate = fuzzify(k, min(abs(lanes[RATE, j]), 1.0))
        K = 1.0 + centroid(fire(e, rate), fuzzy_sets(k).output)
        g = kernel.step_gain(params, K, step.fastest, dt)
        gamma = params._replace(gamma=lanes[GAMMA, j])
        lanes[STEP, j], lanes[LEARNT, j] = g, kernel.bias_gain(gamma, K, g, step.fastest, dt)


@inlined
def _correct(bound_rad_s: float, lanes: Floats) -> None:
    """Turn by the innovation, and learn the bias from it."""
    for j in range(LANES):
        w = (lanes[INNOVATION, j], lanes[INNOVATION + 1, j], lanes[INNOVATION + 2, j])
        q = (lanes[Q, j], lanes[Q + 1, j], lanes[Q + 2, j], lanes[Q + 3, j])
        bias = (lanes[BIAS, j], lanes[BIAS + 1, j], lanes[BIAS + 2, j])
        q = _turned(q, scale(-lanes[STEP, j], w), ALL)
        bias = kernel.bound_each(add(bias, scale(lanes[LEARNT, j], w)), bound_rad_s)
        lanes[Q, j], lanes[Q + 1, j], lanes[Q + 2, j], lanes[Q + 3, j] = q
        lanes[BIAS, j], lanes[BIAS + 1, j], lanes[BIAS + 2, j] = bias


@inlined
def _turned(q: Quaternion, turn: Vec3, terms: int) -> Quaternion:
    """q exp(turn/2) of a unit quaternion and up to 2 rad, by series, and of length one again."""
    x = 0.25 * dot(turn, turn)
    cosine, sine = COSINE[FEW - 1], SINE[FEW - 1]
    if terms > FEW:
        cosine, sine = COSINE[ALL - 1], SINE[ALL - 1]
        for n in range(ALL - 2, FEW - 2, -1):
            cosine, sine = COSINE[n] + x * cosine, SINE[n] + x * sine
    for n in range(FEW - 2, -1, -1):
        cosine, sine = COSINE[n] + x * cosine, SINE[n] + x * sine
    a, b, c = scale(0.5 * sine, turn)
    w, x, y, z = multiply(q, (cosine, a, b, c))
    length = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # 1/sqrt(1 + x) = 1 - x/2
    return (length * w, length * x, length * y, length * z)


@inlined
def _vector(row: Floats) -> Vec3:
    return (row[0], row[1], row[2])


@inlined
def unpack(m: Floats, j: int) -> Memberships:
    """k1..k22 of column ``j`` as the tuple that the fuzzy controller takes."""
    return (
        *(m[0, j], m[1, j], m[2, j], m[3, j], m[4, j], m[5, j], m[6, j], m[7, j], m[8, j]),
        *(m[9, j], m[10, j], m[11, j], m[12, j], m[13, j], m[14, j], m[15, j], m[16, j]),
        *(m[17, j], m[18, j], m[19, j], m[20, j], m[21, j]),
    )
