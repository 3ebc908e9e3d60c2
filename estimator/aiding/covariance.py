"""Covariance of the aiding's errors: one step in time, one scalar measurement."""

import numpy as np

from estimator.aiding.types import ACC_BIAS, GYR_BIAS, SIZE, TURN, VELOCITY, Array
from estimator.compilation.compiled import inlined
from estimator.geometry.axes import axes_of
from estimator.types import Quaternion, Vec3


@inlined
def part(x: Array, first: int) -> Vec3:
    """Three numbers of an array, from ``first`` on."""
    return (x[first], x[first + 1], x[first + 2])


@inlined
def rotation_matrix(q: Quaternion) -> Array:
    """(3, 3) of q_ned_frd: columns are the body axes in NED."""
    return np.array(axes_of(q))


@inlined
def move_rows(P: Array, R: Array, gained: Vec3, dt: float) -> Array:
    """F P, with F the errors' transition over ``dt``.

    turn' = turn - R gyr_bias dt, velocity' = velocity + turn x gained - R acc_bias dt, where
    ``gained`` is the integral of the specific force in NED; the rest stays.
    """
    moved = P.copy()
    for j in range(SIZE):
        t0, t1, t2 = P[TURN, j], P[TURN + 1, j], P[TURN + 2, j]
        for i in range(3):
            for k in range(3):
                moved[TURN + i, j] -= dt * R[i, k] * P[GYR_BIAS + k, j]
                moved[VELOCITY + i, j] -= dt * R[i, k] * P[ACC_BIAS + k, j]
        moved[VELOCITY, j] += t1 * gained[2] - t2 * gained[1]
        moved[VELOCITY + 1, j] += t2 * gained[0] - t0 * gained[2]
        moved[VELOCITY + 2, j] += t0 * gained[1] - t1 * gained[0]
    return moved


@inlined
def expected_variance(P: Array, h: Array, noise: float) -> float:
    """Variance of a measurement h . errors + noise."""
    total = noise
    for i in range(SIZE):
        if h[i] != 0.0:
            for j in range(SIZE):
                total += h[i] * P[i, j] * h[j]
    return total


@inlined
def residual(x: Array, h: Array, innovation: float) -> float:
    """The innovation less h . x, the part that earlier corrections of this step explain."""
    for i in range(SIZE):
        innovation -= h[i] * x[i]
    return innovation


@inlined
def learn(P: Array, x: Array, h: Array, innovation: float, noise: float) -> None:
    """Kalman update of this step's own P and corrections x by one scalar, in place."""
    m = np.zeros(SIZE)
    for j in range(SIZE):
        if h[j] != 0.0:
            for i in range(SIZE):
                m[i] += P[i, j] * h[j]
    variance = noise
    for j in range(SIZE):
        variance += h[j] * m[j]
    step = residual(x, h, innovation) / variance
    for i in range(SIZE):
        x[i] += step * m[i]
        for j in range(SIZE):
            P[i, j] -= m[i] * m[j] / variance
