"""Many rotations at once: quaternions as rows (N, 4), Hamilton, scalar first."""

import numpy as np

from estimator.types import Floats, Vec3


def multiply(p: Floats, q: Floats) -> Floats:
    """Hamilton product, row by row."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    product: Floats = np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )
    return product


def conjugate(q: Floats) -> Floats:
    """The inverse of unit quaternions."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def unit(rows: Floats) -> Floats:
    """Rows of length 1."""
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))


def exp(turns_rad: Floats) -> Floats:
    """The quaternions of rotation vectors (N, 3)."""
    half = 0.5 * np.linalg.norm(turns_rad, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turns_rad], axis=-1)


def log(q: Floats) -> Floats:
    """The rotation vectors (N, 3) of quaternions, of half a turn at most."""
    q = np.where(q[:, :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[:, :1])
    return np.asarray(q[:, 1:] * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0))


def cross(u: Floats, v: Floats) -> Floats:
    """Cross products (N, 3), in a third of NumPy's time."""
    (a, b, c), (x, y, z) = u.T, v.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def rotate(q: Floats, v: Floats) -> Floats:
    """Vectors (N, 3) turned by quaternions: v + 2 (w (u x v) + u x (u x v)), q = (w, u)."""
    twice = 2.0 * cross(q[:, 1:], v)
    return np.asarray(v + q[:, :1] * twice + cross(q[:, 1:], twice))


def about_down(angles_rad: Floats) -> Floats:
    """Rotations (N, 4) about the third axis."""
    none = np.zeros_like(angles_rad)
    half = 0.5 * angles_rad
    return np.stack([np.cos(half), none, none, np.sin(half)], axis=-1)


def heading_of(turns: Floats) -> Floats:
    """The angles (N,) of the part of rotations that is about the third axis."""
    return 2.0 * np.arctan2(turns[:, 3], turns[:, 0])


def wrap(angles_rad: Floats) -> Floats:
    """Angles brought into [-pi, pi)."""
    return np.asarray((angles_rad + np.pi) % (2.0 * np.pi) - np.pi)


def chained(turns: Floats) -> Floats:
    """The products (N, 4) of the first row, of the first two, ... of all.

    In about sqrt(N) steps of as many chains at once.
    """
    n = len(turns)
    length = max(1, round(n**0.5))
    chains = -(-n // length)
    q = np.zeros((chains * length, 4))
    q[:, 0] = 1.0
    q[:n] = turns
    q = q.reshape(chains, length, 4)
    for k in range(1, length):
        q[:, k] = multiply(q[:, k - 1], q[:, k])
    for k in range(1, chains):
        q[k] = multiply(q[k - 1, -1], unit(q[k]))
    return unit(q.reshape(-1, 4)[:n])


def running_product(q: Floats) -> Floats:
    """q_0, q_0 q_1, q_0 q_1 q_2, ... by doubling."""
    product, reach = q, 1
    while reach < len(q):
        product = np.vstack([product[:reach], multiply(product[:-reach], product[reach:])])
        reach *= 2
    return product


def rotate_inverse(q: Floats, v: Vec3 | Floats) -> Floats:
    """R^T v for attitudes (N, 4) and one vector or (N, 3): q* v q."""
    vector = np.zeros_like(q)
    vector[:, 1:] = v
    return np.ascontiguousarray(multiply(multiply(conjugate(q), vector), q)[:, 1:])


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
