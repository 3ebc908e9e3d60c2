"""Rotations of many instants at once: quaternions as arrays (N, 4), scalar first."""

import numpy as np

from estimator.arrays import Floats
from estimator.types import Vec3

CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def exponential(phi: Floats) -> Floats:
    """Rotation vectors (N, 3) to unit quaternions (N, 4)."""
    half = 0.5 * np.sqrt(np.sum(phi**2, axis=1))
    q = np.empty((len(phi), 4))
    q[:, 0] = np.cos(half)
    q[:, 1:] = 0.5 * np.sinc(half / np.pi)[:, None] * phi
    return q


def running_product(q: Floats) -> Floats:
    """q_0, q_0 q_1, q_0 q_1 q_2, ... by doubling."""
    product, reach = q, 1
    while reach < len(q):
        product = np.vstack([product[:reach], multiply(product[:-reach], product[reach:])])
        reach *= 2
    return product


def multiply(p: Floats, q: Floats) -> Floats:
    """Hamilton products of two arrays (N, 4)."""
    a, b, c, d = p.T
    e, f, g, h = q.T
    return np.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ],
        axis=1,
    )


def rotate_inverse(q: Floats, v: Vec3 | Floats) -> Floats:
    """R^T v for attitudes (N, 4) and one vector or (N, 3): q* v q."""
    vector = np.zeros_like(q)
    vector[:, 1:] = v
    return np.ascontiguousarray(multiply(multiply(q * CONJUGATE, vector), q)[:, 1:])


def logarithm(q: Floats) -> Floats:
    """Rotation vectors (N, 3) of unit quaternions (N, 4), of at most 180 deg."""
    q = np.where(q[:, :1] < 0.0, -q, q)
    sine = np.sqrt(np.sum(q[:, 1:] ** 2, axis=1))
    half = np.arctan2(sine, q[:, 0])
    # half / sin(half) by numpy's sin(pi x) / (pi x), which is 1 at 0
    phi: Floats = 2.0 / np.sinc(half / np.pi)[:, None] * q[:, 1:]
    return phi


def from_matrices(R: Floats) -> Floats:
    """Unit quaternions of rotation matrices (N, 3, 3) that tilt by less than 90 deg.

    By the half angles of roll, pitch and yaw, which have no special cases there.
    """
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2]) / 2
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0)) / 2
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0]) / 2
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
