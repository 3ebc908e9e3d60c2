"""The paper's filter with other choices where the paper is silent, one switch each.

What each choice is stands in docs/paper.md.

With no switch turned the steps are those of ``estimator/filter/kernel.py``, which
``benchmarks/paper_choices.py`` checks before it prints anything.
"""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import simulate
from estimator.compilation.compiled import compiled
from estimator.filter.fuzzy import RULES, centroid, fuzzify
from estimator.filter.kernel import (
    attitude_error,
    bias_gain,
    bound_each,
    largest_rate,
    propagate,
    step_gain,
)
from estimator.filter.observation import raw_vectors
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES
from estimator.geometry.quaternion import (
    add,
    cross,
    dot,
    exp,
    multiply,
    norm,
    normalize,
    normalized_distance,
    rotate_inverse,
    scale,
    unit,
)
from tuning.paper_kernel import unpack

SIGNED, RECTIFIED, UNFILTERED, NO_RATE = range(4)

AS_BUILT = np.array(RULES)
# The table's "V" (L, as built) read as VL: a misprint of the other neighbour.
V_AS_VERY_LARGE = np.where(AS_BUILT == 3, 4, AS_BUILT)
# Rows read as the error and columns as its rate.
ROWS_AS_ERROR = np.ascontiguousarray(AS_BUILT.T)


class Switches(NamedTuple):
    """Which choices differ; the defaults are as built."""

    rate: int = SIGNED
    error_is_true: bool = False  # e for the fuzzy controller from the truth
    error_is_clipped: bool = True  # to [0, 1], before its derivative
    cross_is_unit: bool = True  # v3 = v1 x v2 normalised, on both sides
    bias_by_step: bool = False  # the bias grows by gamma/2 dt, not by gamma/2 g/K
    step_is_plain: bool = False  # K dt however long the step is


class Signals(NamedTuple):
    """S seeds of the paper's signals: readings (S, N, 3) and truth (S, N, 4)."""

    gyr_rad_s: np.ndarray
    acc_m_s2: np.ndarray
    mag: np.ndarray
    q_ned_frd: np.ndarray


def signals_of(seeds, rate_hz=COST_RATE_HZ, gyro_noise=1.0, vector_noise=1.0):
    """The signals at a rate, both noises times a factor."""
    samples = round((COST_SAMPLES - 1) * rate_hz / COST_RATE_HZ) + 1
    still = simulate(0, samples, rate_hz, noise=0.0)
    columns = []
    for seed in seeds:
        one = simulate(seed, samples, rate_hz)

        def scale_noise(name, factor, one=one):
            quiet = getattr(still, name)
            return quiet + factor * (getattr(one, name) - quiet)

        columns.append((scale_noise("gyr_rad_s", gyro_noise), scale_noise("acc_m_s2", vector_noise),
                        scale_noise("mag_gauss", vector_noise), one.q_ned_frd))  # fmt: skip
    return Signals(*(np.array(column) for column in zip(*columns, strict=True)))


@compiled
def gain_by_table(k, rules, error, rate):
    """k_op by any table of 25 rules."""
    e = fuzzify(k, min(max(error, 0.0), 1.0))
    d = fuzzify(k, min(abs(rate), 1.0))
    strengths = np.zeros(5)
    for row in range(5):
        for column in range(5):
            term = rules[row, column]
            strengths[term] = max(strengths[term], min(d[row], e[column]))
    sets = (
        (0.0, 0.0, k[11]),
        (k[12], k[13], k[14]),
        (k[15], k[16], k[17]),
        (k[18], k[19], k[20]),
        (k[21], 100.0, 100.0),
    )
    fired = (strengths[0], strengths[1], strengths[2], strengths[3], strengths[4])
    return centroid(fired, sets)


@compiled
def rate_of(switches, tau, state, error, dt):
    """The rate of change of the error, by its four readings."""
    if not state.has_error or dt <= 0.0 or switches.rate == NO_RATE:
        return 0.0
    slope = (error - state.error) / dt
    if switches.rate == UNFILTERED:
        return slope
    if switches.rate == RECTIFIED:
        slope = abs(slope)
    d = state.error_rate_1_s
    return d + dt / (tau + dt) * (slope - d)


@compiled
def correct(params, switches, rules, state, vectors, truth, dt):
    """``kernel.correct`` with the switches; both vectors are there."""
    v1, v2 = vectors.v1_frd, vectors.v2_frd
    u1 = rotate_inverse(state.q_ned_frd, vectors.v1_ned)
    u2 = rotate_inverse(state.q_ned_frd, vectors.v2_ned)
    v3, u3 = cross(v1, v2), cross(u1, u2)
    sine = norm(v3)
    n3, m3 = unit(v3), unit(u3)
    if switches.cross_is_unit:
        v3, u3 = n3, m3
    s1, s2, s3 = vectors.s1, vectors.s2, vectors.s3
    w = add(scale(0.5 * s1, cross(u1, v1)), scale(0.5 * s2, cross(u2, v2)))
    w = add(w, scale(0.5 * s3, cross(u3, v3)))
    e = attitude_error(v1, v2, u1, u2, n3, sine, m3)
    if not switches.error_is_clipped:
        e = 0.25 * (3.0 - (dot(cross(v2, n3), u1) + dot(cross(n3, v1), u2)) / sine - dot(n3, m3))
    if switches.error_is_true:
        e = normalized_distance(truth, state.q_ned_frd)
    d = rate_of(switches, params.rate_time_constant_s, state, e, dt)
    K = (
        params.fixed_gain
        if params.gain_is_fixed
        else 1.0 + gain_by_table(params.memberships, rules, e, d)
    )
    fastest = largest_rate(dot(v1, v2), s1, s2, s3)
    g = K * dt if switches.step_is_plain else step_gain(params, K, fastest, dt)
    q = normalize(multiply(state.q_ned_frd, exp(scale(-g, w))))
    f = bias_gain(params, K, g, fastest, dt)
    if switches.bias_by_step:
        f = 0.5 * params.gamma * dt
    b = bound_each(add(state.gyr_bias_rad_s, scale(f, w)), params.bias_bound_rad_s)
    return FilterState(q, b, e, d, K, True, state.rate_rad_s, state.noise, state.decay)


@compiled
def errors_of(params, reference, switches, rules, start, signals, seed, dt):
    """The true e (N,) before each correction, of one seed."""
    n = signals.gyr_rad_s.shape[1]
    e = np.empty(n)
    state = start
    step_s = params.first_step_s
    for k in range(n):
        gyr = signals.gyr_rad_s[seed, k]
        acc = signals.acc_m_s2[seed, k]
        mag = signals.mag[seed, k]
        true = signals.q_ned_frd[seed, k]
        truth = (true[0], true[1], true[2], true[3])
        if k > 0:
            step_s = dt
            state = propagate(state, (gyr[0], gyr[1], gyr[2]), dt)
        e[k] = normalized_distance(truth, state.q_ned_frd)
        vectors = raw_vectors(reference, (acc[0], acc[1], acc[2]), (mag[0], mag[1], mag[2]), True)
        state = correct(params, switches, rules, state, vectors, truth, step_s)
    return e


@compiled
def cost_of(e, rate_hz):
    """J of Eq. (15); for steps other than 0.01 s its sums are weighted by the step."""
    per_s = round(rate_hz)
    transient, steady = e[: per_s + 1].sum(), e[4 * per_s : 14 * per_s + 1].sum()
    return (0.3 * transient + steady) * 100.0 / rate_hz


@compiled
def costs_of(params, reference, switches, rules, start, signals, rate_hz, candidates):
    """J (C, S) of memberships (C, 22) on each seed."""
    seeds = len(signals.gyr_rad_s)
    costs = np.empty((len(candidates), seeds))
    for i in range(costs.size):
        c, s = i // seeds, i % seeds
        own = FilterParams(
            gamma=params.gamma,
            bias_bound_rad_s=params.bias_bound_rad_s,
            rate_time_constant_s=params.rate_time_constant_s,
            euler_step_max_s=params.euler_step_max_s,
            first_step_s=params.first_step_s,
            memberships=unpack(candidates[c]),
            gain_is_fixed=params.gain_is_fixed,
            fixed_gain=params.fixed_gain,
            gain_knows_noise=False,
        )
        e = errors_of(own, reference, switches, rules, start, signals, s, 1.0 / rate_hz)
        costs[c, s] = cost_of(e, rate_hz)
    return costs
