"""The words that tests are written in: samplers of rotations, and when attitudes are close."""

from math import atan2, hypot, pi, sqrt

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimator.filter import memberships
from estimator.types import Quaternion, Vec3

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def unit_vectors() -> st.SearchStrategy[Vec3]:
    """Directions; the axes and their opposites are among them."""
    cube = st.tuples(*[floats(-1.0, 1.0)] * 3).filter(lambda v: sqrt(sum(x * x for x in v)) > 1e-3)
    return cube.map(lambda v: tuple(x / sqrt(sum(y * y for y in v)) for x in v))


def rotation_vectors(low_rad: float = 0.0, high_rad: float = pi) -> st.SearchStrategy[Vec3]:
    return st.builds(
        lambda axis, angle: tuple(angle * x for x in axis),
        unit_vectors(),
        floats(low_rad, high_rad),
    )


def rotations(low_rad: float = 0.0, high_rad: float = pi) -> st.SearchStrategy[Quaternion]:
    """Unit quaternions by an angle in the given range, of either sign."""

    def build(phi: Vec3, sign: float) -> Quaternion:
        x, y, z, w = Rotation.from_rotvec(phi).as_quat()
        return (sign * float(w), sign * float(x), sign * float(y), sign * float(z))

    return st.builds(build, rotation_vectors(low_rad, high_rad), st.sampled_from((1.0, -1.0)))


def any_rotation() -> st.SearchStrategy[Quaternion]:
    """Uniform in angle, with the two ends drawn as often as the middle."""
    return st.one_of(rotations(), rotations(0.0, 1e-3), rotations(pi - 1e-3, pi))


def random_quaternion(rng: np.random.Generator) -> Quaternion:
    """Uniform on SO(3)."""
    q = rng.standard_normal(4)
    return tuple((q / np.linalg.norm(q)).tolist())


def random_unit_vector(rng: np.random.Generator) -> Vec3:
    v = rng.standard_normal(3)
    return tuple((v / np.linalg.norm(v)).tolist())


def random_memberships(
    rng: np.random.Generator, round_to: float | None = None
) -> tuple[float, ...]:
    """Feasible k1..k22: uniform within the bounds, sorted inside each triangle.

    With ``round_to`` the values fall on a grid, so that corners coincide.
    """
    k = rng.uniform(memberships.LOWER, memberships.UPPER)
    if round_to is not None:
        step = np.where(np.arange(22) < 11, round_to, 100.0 * round_to)
        k = np.clip(np.round(k / step) * step, memberships.LOWER, memberships.UPPER)
    for chain in memberships.CHAINS:
        k[list(chain)] = np.sort(k[list(chain)])
    return tuple(k.tolist())


def scipy_rotation(q: Quaternion) -> Rotation:
    """The same rotation in scipy, whose quaternions have the scalar last."""
    return Rotation.from_quat(q, scalar_first=True)


def angle_rad(q: Quaternion, r: Quaternion) -> float:
    """Angle of the rotation between two attitudes, 0..pi; q and -q are one attitude."""
    w = sum(a * b for a, b in zip(q, r, strict=True))
    p = [a - (1.0 if w >= 0.0 else -1.0) * b for a, b in zip(q, r, strict=True)]
    half_chord = 0.5 * sqrt(sum(x * x for x in p))
    return 4.0 * atan2(half_chord, sqrt(max(0.0, 1.0 - half_chord**2)))


def assert_attitude_close(q: Quaternion, r: Quaternion, max_angle_rad: float) -> None:
    """Both are unit quaternions, and the turn between them is at most ``max_angle_rad``."""
    assert [hypot(*each) for each in (q, r)] == pytest.approx([1.0, 1.0], abs=1e-9)
    assert angle_rad(q, r) <= max_angle_rad, f"{q} and {r}"
