"""The part of a difference in inclination that is one constant turn: a mounting, or a trim."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import msgspec
import numpy as np

from estimator.arrays import Bools, Floats
from fuzzbee.replays.score import Means


class ConstantTurn(msgspec.Struct, frozen=True):
    """One turn of the body that fits best, and what is left of the inclination's errors without.

    ``turn_deg`` is by how much it leans the vertical, RMS over the samples.
    """

    turn_deg: float
    inclination_rms: float
    inclination_coverage: float
    inclination_coverage_moving: float | None


class Turned(NamedTuple):
    """Two attitudes (N, 4) of the body, the inclination's sigma (N,), and whether it moved (N,)."""

    estimates: Floats
    reference: Floats
    sigma_rad: Floats
    moved: Bools


def constant_turn(parts: Callable[[], Iterable[Turned]]) -> ConstantTurn | None:
    """The turn between two attitudes; None without samples. The parts are gone through twice.

    R of the least sum of |R d - d_reference|^2 over down in the body (Wahba's problem, by SVD:
    F. L. Markley 1988).
    """
    products = [down_in_body(part.reference).T @ down_in_body(part.estimates) for part in parts()]
    u, _, vt = np.linalg.svd(np.sum(products, axis=0) if products else np.eye(3))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    means = Means()
    for part in parts():
        down = down_in_body(part.estimates)
        turned = down @ turn.T
        left_rad = _between(turned, down_in_body(part.reference))
        inside = left_rad <= part.sigma_rad
        means.add("turn", np.square(np.degrees(_between(turned, down))))
        means.add("left", np.square(np.degrees(left_rad)))
        means.add("inside", inside)
        means.add("moving", inside[part.moved])
    turn_deg, left_deg, inside_all = means.root("turn"), means.root("left"), means.mean("inside")
    if turn_deg is None or left_deg is None or inside_all is None:
        return None
    return ConstantTurn(turn_deg, left_deg, inside_all, means.mean("moving"))


def down_in_body(q_ned_frd: Floats) -> Floats:
    """(N, 3): the third row of the rotation matrix of each (N, 4) quaternion."""
    w, x, y, z = q_ned_frd.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _between(some: Floats, others: Floats) -> Floats:
    """Angles (N,) between unit vectors, rad."""
    sine = np.linalg.norm(np.cross(some, others), axis=1)
    return np.asarray(np.arctan2(sine, np.sum(some * others, axis=1)))
