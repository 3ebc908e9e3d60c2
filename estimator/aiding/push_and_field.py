"""The attitude from one push and the field: two directions that are known in NED and seen from G.

The push is what a window of the search by velocity has shown (:mod:`estimator.aiding.search`), the
field that of the place. Two such pairs are the least that Wahba's problem needs.
"""

from math import hypot
from typing import NamedTuple

import numpy as np

from estimator.aiding.search import Push, Solution, information
from estimator.bounds import TINY
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import HEADING_REACH_RAD, REACH
from estimator.filter.alignment import nearest_rotation, quaternion_from_matrix
from estimator.geometry.quaternion import angle_between_vectors, cross, norm, rotate, unit
from estimator.types import Quaternion, Vec3


class PushAndField(NamedTuple):
    """Two vectors that show the attitude of G at once, each in NED and in G, and their sigmas."""

    push: Push  # what the search has shown last
    change_sigma_m_s: float  # of its change of velocity
    late_sigma_s: float  # of the age of its reports and of the samples
    field_ned: Vec3  # of the place, any unit
    field_g: Vec3  # as seen, any unit
    field_sigma_rad: float  # of its direction


def solve_with_field(seen: PushAndField) -> Solution | None:
    """The attitude of G by the push and the field of the place.

    If the angle between the two, or the size of the push, is not as expected, one of them is wrong,
    and nothing is returned.
    """
    change, force, swing = seen.push[:3]
    size, expected = norm(change), angle_between_vectors(change, seen.field_ned)
    off_rad = abs(angle_between_vectors(force, seen.field_g) - expected)
    scatter = max(NORM_SCALE, REACH * seen.change_sigma_m_s / max(size, TINY))
    fits = off_rad <= scatter and abs(norm(force) - size) <= scatter * size
    if not fits:  # so it is, too, where the push is no number
        return None
    weight = (seen.change_sigma_m_s / seen.field_sigma_rad) ** 2
    B = np.outer(change, force) + weight * np.outer(unit(seen.field_ned), unit(seen.field_g))
    R = nearest_rotation(B)
    M = information(B @ R.T)
    if float(np.linalg.eigvalsh(M)[0]) * HEADING_REACH_RAD**2 <= seen.change_sigma_m_s**2:
        return None  # the two are nearly parallel
    inverse = np.linalg.inv(M)
    by_age = seen.late_sigma_s * (inverse @ R @ np.array(cross(force, swing)))
    north, east, down = np.sqrt(seen.change_sigma_m_s**2 * np.diag(inverse) + by_age**2).tolist()
    tilt = max(north, east)
    is_known = hypot(tilt, down) < HEADING_REACH_RAD
    return Solution(quaternion_from_matrix(R), down, tilt) if is_known else None


def misfits(seen: PushAndField, q_ned_g: Quaternion) -> tuple[float, float]:
    """By how many sigmas the push and the field point elsewhere, if that is G's attitude."""
    change, force, swing = seen.push[:3]
    push_rad = angle_between_vectors(rotate(q_ned_g, force), change)
    field_rad = angle_between_vectors(rotate(q_ned_g, seen.field_g), seen.field_ned)
    sigma_m_s = hypot(seen.change_sigma_m_s, seen.late_sigma_s * norm(swing))
    return push_rad * norm(change) / sigma_m_s, field_rad / seen.field_sigma_rad
