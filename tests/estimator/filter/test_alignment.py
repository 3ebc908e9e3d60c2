"""The first attitude, against scipy's solution of Wahba's problem."""

from math import pi

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from estimator.filter.alignment import align, nearest_rotation, quaternion_from_matrix
from estimator.filter.types import Vectors
from estimator.geometry import quaternion as qn
from tests.estimator.filter.vehicles import GRAVITY, MAGNETIC, seen_from
from tests.vocabulary import (
    IDENTITY,
    any_rotation,
    assert_attitude_close,
    random_quaternion,
    random_unit_vector,
    scipy_rotation,
)

NORTH = (1.0, 0.0, 0.0)
PAPER_START = np.array(
    [[-0.0074, 0.8557, 0.5175], [0.8802, -0.2399, 0.4094], [0.4745, 0.4586, -0.7514]]
)


@given(any_rotation())
def test_matrix_to_quaternion_undoes_scipys(q):
    again = quaternion_from_matrix(scipy_rotation(q).as_matrix())
    assert again[0] >= 0.0
    assert_attitude_close(again, q, 1e-14)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0]]]).tolist())
@pytest.mark.parametrize("angle", [0.0, 1e-9, pi / 2, pi - 1e-9, pi])
def test_every_component_may_be_the_largest(axis, angle):
    rotation = Rotation.from_rotvec(angle * np.array(axis))
    q = tuple(rotation.as_quat(scalar_first=True).tolist())
    assert_attitude_close(quaternion_from_matrix(rotation.as_matrix()), q, 1e-14)


def test_papers_start_is_projected():
    """Given to 4 decimals, R_hat(0) is no rotation; its neighbour is, and e = 0.9997 there."""
    assert abs(np.linalg.det(PAPER_START) - 1.0) > 1e-6
    R = nearest_rotation(PAPER_START)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R, PAPER_START, atol=1e-4)  # four decimals
    theirs = Rotation.from_matrix(R)
    q = quaternion_from_matrix(R)
    assert_attitude_close(q, tuple(theirs.as_quat(scalar_first=True).tolist()), 1e-14)
    assert qn.normalized_distance(IDENTITY, q) == pytest.approx(0.9997, abs=5e-5)


@given(any_rotation())
def test_exact_vectors_give_the_attitude(q):
    assert_attitude_close(align(seen_from(q)), q, 1e-13)


def test_noisy_vectors_agree_with_scipy():
    rng = np.random.default_rng(51)
    for _ in range(300):
        exact = seen_from(random_quaternion(rng))
        s1, s2 = rng.uniform(0.1, 5.0, 2).tolist()
        v1, v2 = (qn.unit(tuple(v + rng.normal(0.0, 0.1, 3))) for v in (exact.v1_frd, exact.v2_frd))
        ours = align(exact._replace(v1_frd=v1, v2_frd=v2, s1=s1, s2=s2))
        theirs, _ = Rotation.align_vectors([MAGNETIC, GRAVITY], [v1, v2], weights=[s1, s2])
        # scipy solves for a matrix too; near-equal singular values cost some digits
        assert_attitude_close(ours, tuple(theirs.as_quat(scalar_first=True).tolist()), 1e-9)


def by_gravity(v):
    return align(Vectors((0.0, 0.0, 0.0), MAGNETIC, 0.0, v, GRAVITY, 1.0, 1.0))


def test_gravity_alone_levels_by_the_smallest_turn():
    rng, up = np.random.default_rng(52), (0.0, 0.0, -1.0)
    for v in (random_unit_vector(rng) for _ in range(50)):
        q = by_gravity(v)
        np.testing.assert_allclose(qn.rotate(q, v), GRAVITY, atol=1e-12)
        assert q[3] == pytest.approx(0.0, abs=1e-12)  # no turn about the vertical
    assert_attitude_close(by_gravity(GRAVITY), IDENTITY, 1e-14)
    np.testing.assert_allclose(qn.rotate(by_gravity(up), up), GRAVITY, atol=1e-14)


def test_field_alone_points_the_field():
    v = random_unit_vector(np.random.default_rng(53))
    q = align(Vectors(v, NORTH, 1.0, (0.0, 0.0, 0.0), GRAVITY, 0.0, 1.0))
    np.testing.assert_allclose(qn.rotate(q, v), NORTH, atol=1e-12)
    # by the smallest turn: what the one direction does not show stays as it was
    assert_attitude_close(q, qn.shortest_rotation(v, NORTH), 1e-12)
    without_gravity = align(Vectors(v, NORTH, 1.0, (0.6, 0.0, 0.8), GRAVITY, 0.0, 1.0))
    assert_attitude_close(without_gravity, q, 1e-12)  # a confidence of zero takes gravity out


def test_no_vector_gives_some_attitude():
    q = align(Vectors((0.0,) * 3, MAGNETIC, 0.0, (0.0,) * 3, GRAVITY, 0.0, 1.0))
    assert_attitude_close(q, q, 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_collinear_vectors_still_level(sign):
    """A field along gravity leaves the heading open; the answer is a rotation that levels."""
    rng = np.random.default_rng(54)
    along = (0.0, 0.0, sign)
    for _ in range(20):
        q = random_quaternion(rng)
        v1, v2 = qn.rotate_inverse(q, along), qn.rotate_inverse(q, GRAVITY)
        found = align(Vectors(v1, along, 1.0, v2, GRAVITY, 1.0, 1.0))
        np.testing.assert_allclose(qn.rotate(found, v2), GRAVITY, atol=1e-7)
