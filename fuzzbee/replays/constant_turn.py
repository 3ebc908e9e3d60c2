"""The part of a difference in inclination that is one constant turn: a mounting, or a trim."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.geometry.metrics import rms

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class ConstantTurn(msgspec.Struct, frozen=True):
    """One turn of the body that fits best, and what is left of the inclination's errors without.

    ``turn_deg`` is by how much it leans the vertical, RMS over the samples.
    """

    turn_deg: float
    inclination_rms: float
    inclination_coverage: float
    inclination_coverage_moving: float | None


def constant_turn(
    estimates: Floats, reference: Floats, sigma_rad: Floats, moved: Bools
) -> ConstantTurn | None:
    """The turn between two attitudes (N, 4) of the body; None without samples.

    R of the least sum of |R d - d_reference|^2 over down in the body (Wahba's problem, by SVD:
    F. L. Markley 1988). ``sigma_rad`` (N,) is the inclination's, ``moved`` (N,) says in motion.
    """
    if len(estimates) == 0:
        return None
    down, wanted = down_in_body(estimates), down_in_body(reference)
    u, _, vt = np.linalg.svd(wanted.T @ down)
    turned = down @ (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    left_rad = _between(turned, wanted)
    inside = left_rad <= sigma_rad
    return ConstantTurn(
        turn_deg=rms(np.degrees(_between(turned, down))),
        inclination_rms=rms(np.degrees(left_rad)),
        inclination_coverage=float(np.mean(inside)),
        inclination_coverage_moving=float(np.mean(inside[moved])) if moved.any() else None,
    )


def down_in_body(q_ned_frd: Floats) -> Floats:
    """(N, 3): the third row of the rotation matrix of each (N, 4) quaternion."""
    w, x, y, z = q_ned_frd.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _between(some: Floats, others: Floats) -> Floats:
    """Angles (N,) between unit vectors, rad."""
    sine = np.linalg.norm(np.cross(some, others), axis=1)
    return np.asarray(np.arctan2(sine, np.sum(some * others, axis=1)))
