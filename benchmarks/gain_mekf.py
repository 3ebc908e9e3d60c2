"""Multiplicative extended Kalman filters on the paper's signals: the rivals of another family.

Attitude error in the body frame and the gyroscope's bias (6 states); with ``BIASED`` also a
constant error of each vector in the body frame (12 states). The vectors are taken with their
length. One scalar measurement after the other, so that nothing has to be inverted. Where the
innovation of a sample is far larger than it should be, the attitude's covariance begins anew.

Source: F. L. Markley, "Attitude error representations for Kalman filtering", Journal of Guidance,
Control, and Dynamics 26(2), 2003, doi 10.2514/2.5048.
"""

import numpy as np
from gain_laws import DT_S, Law

from estimator.compilation.compiled import compiled, inlined
from estimator.geometry.quaternion import (
    exp,
    multiply,
    normalize,
    normalized_distance,
    rotate_inverse,
)

PLAIN, BIASED = 6, 12

# Densities and sigmas; ``reset`` is the squared innovation over its variance, per measurement.
_NAMES = ("gyroscope", "vectors", "attitude", "bias", "reset", "vector_bias")
_LOWER = (0.02, 0.02, 0.3, 0.01, 2.0, 0.01)
_UPPER = (2.0, 0.5, 4.0, 1.0, 100.0, 0.5)

FILTERS = {
    "MEKF, 6 states, covariance reset": Law(PLAIN, _NAMES[:5], _LOWER[:5], _UPPER[:5]),
    "MEKF, vectors' biases modelled": Law(BIASED, _NAMES, _LOWER, _UPPER),
}


@inlined
def predict(P, turn, noise):
    """P <- F P F' + Q in place: delta' = delta - turn x delta - dt db changes three rows only."""
    F = np.zeros((3, 6))
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 1], F[0, 2] = turn[2], -turn[1]
    F[1, 0], F[1, 2] = -turn[2], turn[0]
    F[2, 0], F[2, 1] = turn[1], -turn[0]
    F[0, 3] = F[1, 4] = F[2, 5] = -DT_S
    size = len(P)
    rows = np.zeros((3, size))
    for i in range(3):
        for j in range(size):
            for m in range(6):
                rows[i, j] += F[i, m] * P[m, j]
    for i in range(3):
        for j in range(3, size):
            P[i, j] = P[j, i] = rows[i, j]
        for j in range(3):
            P[i, j] = 0.0
            for m in range(6):
                P[i, j] += F[j, m] * rows[i, m]
        P[i, i] += noise


@inlined
def observe(H, innovation, first, u, v, state):
    """Three rows: u + u x delta, the attitude's part of H being [u]x, and the vector's bias."""
    H[first, 0], H[first, 1], H[first, 2] = 0.0, -u[2], u[1]
    H[first + 1, 0], H[first + 1, 1], H[first + 1, 2] = u[2], 0.0, -u[0]
    H[first + 2, 0], H[first + 2, 1], H[first + 2, 2] = -u[1], u[0], 0.0
    for i in range(3):
        innovation[first + i] = v[i] - u[i]
        if len(state) > PLAIN:
            innovation[first + i] -= state[6 + first + i]


@inlined
def column(P, H, i, PH):
    """P H_i' into ``PH``; returns H_i P H_i'."""
    size = len(P)
    for j in range(size):
        PH[j] = P[j, 0] * H[i, 0] + P[j, 1] * H[i, 1] + P[j, 2] * H[i, 2]
        if size > PLAIN:
            PH[j] += P[j, 6 + i]
    return row_product(H, i, PH)


@inlined
def row_product(H, i, x):
    """H_i x."""
    total = H[i, 0] * x[0] + H[i, 1] * x[1] + H[i, 2] * x[2]
    return total + x[6 + i] if len(x) > PLAIN else total


@inlined
def begin_anew(P, variance):
    """The attitude's covariance as at the start, without correlations."""
    for i in range(3):
        for j in range(len(P)):
            P[i, j] = P[j, i] = 0.0
        P[i, i] = variance


@inlined
def update(P, H, innovation, r, moved):
    """The six measurements one after the other; the whole correction into ``moved``."""
    size = len(P)
    PH = np.zeros(size)
    for i in range(6):
        S = column(P, H, i, PH) + r
        left = innovation[i] - row_product(H, i, moved)
        for j in range(size):
            moved[j] += PH[j] / S * left
        for j in range(size):
            for m in range(size):
                P[j, m] -= PH[j] * PH[m] / S


@compiled
def mekf_errors(size, p, start, gyr, v1, v2, i1, i2, truth, errors):
    """The true e (N,) before each correction, into ``errors``. v1, v2 (N, 3) are not unit."""
    q = (start[0], start[1], start[2], start[3])
    state = np.zeros(size)  # the attitude's part is always moved into q
    P = np.zeros((size, size))
    for i in range(3):
        P[i, i], P[3 + i, 3 + i] = p[2] ** 2, p[3] ** 2
    for i in range(6, size):
        P[i, i] = p[5] ** 2
    r = p[1] ** 2
    H, innovation, PH = np.zeros((6, 3)), np.zeros(6), np.zeros(size)
    for k in range(len(gyr)):
        if k > 0:
            x, y, z = gyr[k, 0] - state[3], gyr[k, 1] - state[4], gyr[k, 2] - state[5]
            turn = (DT_S * x, DT_S * y, DT_S * z)
            q = normalize(multiply(q, exp(turn)))
            predict(P, turn, (p[0] * DT_S) ** 2)
        errors[k] = normalized_distance((truth[k, 0], truth[k, 1], truth[k, 2], truth[k, 3]), q)
        observe(H, innovation, 0, rotate_inverse(q, (i1[0], i1[1], i1[2])), v1[k], state)
        observe(H, innovation, 3, rotate_inverse(q, (i2[0], i2[1], i2[2])), v2[k], state)
        surprise = 0.0
        for i in range(6):
            surprise += innovation[i] ** 2 / (column(P, H, i, PH) + r) / 6.0
        if surprise > p[4]:
            begin_anew(P, p[2] ** 2)
        moved = np.zeros(size)
        update(P, H, innovation, r, moved)
        q = normalize(multiply(q, exp((moved[0], moved[1], moved[2]))))
        for j in range(3, size):
            state[j] += moved[j]


@compiled
def filter_errors(size, candidates, starts, gyr, v1, v2, i1, i2, truth):
    """The true e (C, S, N) of candidates (C, D) on S seeds."""
    seeds, samples = gyr.shape[0], gyr.shape[1]
    errors = np.empty((len(candidates), seeds, samples))
    for i in range(len(candidates) * seeds):
        c, s = i // seeds, i % seeds
        mekf_errors(
            size, candidates[c], starts[s], gyr[s], v1[s], v2[s], i1, i2, truth, errors[c, s]
        )
    return errors
