"""Ways to set the gain that the paper's fuzzy controller is compared with, as compiled steps.

All see what the controller sees: the paper's measured e, its low-passed rate, and the time. The
filter around them is the project's own.
"""

from math import exp
from typing import NamedTuple

import numpy as np

from estimator.compilation.compiled import compiled, inlined
from estimator.filter.fuzzy import operating_gain
from estimator.filter.kernel import attitude_error, correct, error_rate, propagate
from estimator.filter.noise_gain import NO_NOISE
from estimator.filter.observation import raw_vectors
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.quaternion import cross, norm, normalized_distance, rotate_inverse, scale
from estimator.types import ZERO_VEC3
from tuning.paper_kernel import unpack

DT_S = 0.01
LARGEST = 124.0  # with a larger K a plain step of 10 ms would be too long

FIXED, LINEAR, SWITCH, HYSTERESIS, SCHEDULE, FUZZY, NOISE = range(7)


class Law(NamedTuple):
    """A law: its number, its parameters with their bounds (None: not tuned), and its start."""

    kind: int
    names: tuple[str, ...] = ()
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    aligned: bool = False


LAWS = {
    "fixed K": Law(FIXED, ("K",), (0.5,), (LARGEST,)),
    "linear, K = a + b e": Law(LINEAR, ("a", "b"), (0.5, 1.0), (50.0, 1000.0)),
    "two levels, on e or |de/dt|": Law(
        SWITCH, ("low", "high", "e", "rate"), (0.5, 20.0, 0.005, 0.02), (20.0, LARGEST, 0.9, 5.0)
    ),
    "two levels with hysteresis": Law(
        HYSTERESIS,
        ("low", "high", "off", "on"),
        (0.5, 20.0, 0.001, 0.01),
        (20.0, LARGEST, 0.2, 0.9),
    ),
    "schedule over time": Law(
        SCHEDULE, ("last", "first", "time_s"), (0.5, 20.0, 0.02), (20.0, LARGEST, 5.0)
    ),
    "aligned at the first sample, fixed K": Law(FIXED, ("K",), (0.5,), (LARGEST,), aligned=True),
}


@inlined
def law_gain(kind, p, high, e, d, t):
    """K, and whether a switch is high."""
    if kind == FIXED:
        return p[0], high
    if kind == LINEAR:
        return p[0] + p[1] * e, high
    if kind == SWITCH:
        high = e > p[2] or abs(d) > p[3]
        return (p[1] if high else p[0]), high
    if kind == HYSTERESIS:
        high = e > p[2] if high else e > max(p[2], p[3])
        return (p[1] if high else p[0]), high
    if kind == SCHEDULE:
        return p[0] + (p[1] - p[0]) * exp(-t / p[2]), high
    return 1.0 + operating_gain(unpack(p), e, d), high


@inlined
def measured_error(state, vectors):
    """The paper's e, as ``correct`` will find it."""
    v1, v2 = vectors.v1_frd, vectors.v2_frd
    u1 = rotate_inverse(state.q_ned_frd, vectors.v1_ned)
    u2 = rotate_inverse(state.q_ned_frd, vectors.v2_ned)
    v3, u3 = cross(v1, v2), cross(u1, u2)
    sine = norm(v3)
    v3, u3 = scale(1.0 / sine, v3), scale(1.0 / norm(u3), u3)
    return attitude_error(v1, v2, u1, u2, v3, sine, u3)


@inlined
def with_gain(params, K, knows_noise):
    """The filter's parameters at a fixed gain."""
    return FilterParams(
        params.gamma,
        params.bias_bound_rad_s,
        params.rate_time_constant_s,
        params.euler_step_max_s,
        params.first_step_s,
        params.memberships,
        not knows_noise,
        K,
        knows_noise,
    )


@compiled
def true_errors(kind, p, params, reference, start, gyr, acc, mag, truth, errors):
    """The true e (N,) before each correction, into ``errors``."""
    q = (start[0], start[1], start[2], start[3])
    state = FilterState(q, ZERO_VEC3, 0.0, 0.0, 1.0, False, ZERO_VEC3, NO_NOISE)
    high = True
    for k in range(len(gyr)):
        if k > 0:
            state = propagate(state, (gyr[k, 0], gyr[k, 1], gyr[k, 2]), DT_S)
        true = (truth[k, 0], truth[k, 1], truth[k, 2], truth[k, 3])
        errors[k] = normalized_distance(true, state.q_ned_frd)
        down, field = (acc[k, 0], acc[k, 1], acc[k, 2]), (mag[k, 0], mag[k, 1], mag[k, 2])
        vectors = raw_vectors(reference, down, field, True)
        K = 1.0
        if kind != NOISE:
            e = measured_error(state, vectors)
            d = error_rate(params, state, e, DT_S)
            K, high = law_gain(kind, p, high, e, d, k * DT_S)
        state = correct(with_gain(params, K, kind == NOISE), state, vectors, DT_S)


@compiled
def law_errors(kind, candidates, params, reference, starts, gyr, acc, mag, truth):
    """The true e (C, S, N) of candidates (C, D) on S seeds."""
    seeds, samples = gyr.shape[0], gyr.shape[1]
    errors = np.empty((len(candidates), seeds, samples))
    for i in range(len(candidates) * seeds):
        c, s = i // seeds, i % seeds
        true_errors(
            kind,
            candidates[c],
            params,
            reference,
            starts[s],
            gyr[s],
            acc[s],
            mag[s],
            truth,
            errors[c, s],
        )
    return errors
