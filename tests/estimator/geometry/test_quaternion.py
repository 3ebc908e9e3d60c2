"""Group axioms of the quaternion algebra, and scipy as the independent second opinion."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimator.geometry import quaternion as qn
from tests.vocabulary import (
    IDENTITY,
    any_rotation,
    assert_attitude_close,
    floats,
    rotation_vectors,
    scipy_rotation,
    unit_vectors,
)

# A handful of roundings (2.2e-16 each) of numbers near 1.
ROUNDING_RAD = 1e-14
# The angle of a rotation is the inverse cosine or sine of numbers with that rounding; near pi and 0
# atan2 keeps it, so that only a few more roundings are allowed.
ANGLE_ROUNDING_RAD = 1e-13

vectors = st.tuples(*[floats(-100.0, 100.0)] * 3)


@given(any_rotation(), any_rotation())
def test_product_agrees_with_scipy(p, q):
    theirs = (scipy_rotation(p) * scipy_rotation(q)).as_quat(scalar_first=True)
    assert_attitude_close(qn.multiply(p, q), tuple(theirs.tolist()), ROUNDING_RAD)


@given(any_rotation(), vectors)
def test_rotate_agrees_with_scipy(q, v):
    theirs = scipy_rotation(q).apply(v)
    np.testing.assert_allclose(qn.rotate(q, v), theirs, atol=1e-12)  # 100 times 1e-14
    back = scipy_rotation(q).inv().apply(v)
    np.testing.assert_allclose(qn.rotate_inverse(q, v), back, atol=1e-12)


@given(any_rotation())
def test_exp_undoes_log(q):
    """Also near the identity and near half a turn."""
    phi = qn.log(q)
    assert qn.norm(phi) <= pi + ANGLE_ROUNDING_RAD
    assert_attitude_close(qn.exp(phi), q, ANGLE_ROUNDING_RAD)
    theirs = scipy_rotation(q).as_rotvec()
    apart = min(np.abs(np.array(phi) - theirs).max(), np.abs(np.array(phi) + theirs).max())
    assert apart < 1e-12


@pytest.mark.parametrize(
    "angle",
    # both sides of the series' threshold (half angle 1e-4), tiny, and next to half a turn
    [0.0, 1e-300, 1e-160, 1e-12, 1.99e-4, 2e-4, 2.01e-4, 1e-3, 3.0, pi - 1e-3, pi - 1e-9],
)
@given(axis=unit_vectors())
def test_log_undoes_exp(angle, axis):
    phi = qn.scale(angle, axis)
    # the angle's rounding, and that of an axis of length 1
    np.testing.assert_allclose(
        qn.log(qn.exp(phi)), phi, rtol=1e-12, atol=1e-15 * max(angle, 1e-300)
    )


@given(rotation_vectors(0.0, 50.0))
def test_exp_agrees_with_scipy_beyond_one_turn(phi):
    theirs = tuple(Rotation.from_rotvec(phi).as_quat(scalar_first=True).tolist())
    assert_attitude_close(qn.exp(phi), theirs, 1e-13)


@given(any_rotation(), any_rotation())
def test_angle_between_agrees_with_scipy(p, q):
    theirs = (scipy_rotation(p).inv() * scipy_rotation(q)).magnitude()
    assert qn.angle_between(p, q) == pytest.approx(theirs, abs=ANGLE_ROUNDING_RAD)
    e = qn.normalized_distance(p, q)
    assert e == pytest.approx(np.sin(theirs / 2) ** 2, abs=1e-14)
    R = scipy_rotation(p).as_matrix().T @ scipy_rotation(q).as_matrix()
    assert e == pytest.approx(np.trace(np.eye(3) - R) / 4.0, abs=1e-14)


@given(unit_vectors(), unit_vectors(), floats(0.01, 100.0))
def test_shortest_rotation_takes_one_direction_to_the_other(u, v, factor):
    q = qn.shortest_rotation(qn.scale(factor, u), v)
    assert hypot(*q) == pytest.approx(1.0, abs=1e-14)
    # next to opposite vectors (w < 1e-12, 1.4e-6 rad) half a turn is taken
    np.testing.assert_allclose(qn.rotate(q, u), v, atol=2e-6)
    assert qn.angle_between(q, IDENTITY) == pytest.approx(qn.angle_between_vectors(u, v), abs=2e-6)


@given(unit_vectors())
def test_shortest_rotation_of_opposite_and_equal_vectors(u):
    half_turn = qn.shortest_rotation(u, qn.scale(-1.0, u))
    np.testing.assert_allclose(qn.rotate(half_turn, u), qn.scale(-1.0, u), atol=1e-14)
    assert_attitude_close(qn.shortest_rotation(u, u), IDENTITY, ROUNDING_RAD)


@pytest.mark.parametrize("gap_rad", [1e-3, 1e-5, 3e-6, 1e-6, 1e-7, 1e-9])
def test_shortest_rotation_next_to_opposite_vectors(gap_rad):
    u = (0.0, 0.0, 1.0)
    v = (np.sin(gap_rad), 0.0, -np.cos(gap_rad))
    np.testing.assert_allclose(qn.rotate(qn.shortest_rotation(u, v), u), v, atol=2e-6)


def test_zero_is_refused_nowhere_and_stays_harmless():
    assert qn.unit((0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert qn.normalize((0.0, 0.0, 0.0, 0.0)) == IDENTITY


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-12, 1e-9, -4.9e-9, 5.1e-9, -1e-7, 1e-3, 1.0, 1e6])
def test_normalize_is_exact_on_both_sides_of_its_series(off):
    """Beside extended precision: to two units in the last place of the largest component."""
    rng = np.random.default_rng(5)
    for values in rng.standard_normal((200, 4)):
        q = (1.0 + off) / np.linalg.norm(values) * values
        exact = q.astype(np.longdouble)
        exact /= np.sqrt(np.sum(exact**2))
        assert np.abs(np.array(qn.normalize(tuple(q.tolist()))) - exact).max() < 4.5e-16


@pytest.mark.parametrize("tangent", [0.0, 1e-300, 1e-9, 1e-3, 0.02, 0.0499, 0.0501, 0.3, 2.0, 1e9])
def test_direction_is_exact_on_both_sides_of_its_series(tangent):
    """Beside extended precision, to two units in the last place; in all four quadrants."""
    for x, y in ((1.0, tangent), (0.3, -0.3 * tangent), (-7.0, 7.0 * tangent), (-1.0, -tangent)):
        exact = np.arctan2(np.longdouble(y), np.longdouble(x))
        assert abs(qn.direction(x, y) - exact) <= 4.5e-16 * abs(exact)
    assert qn.direction(0.0, 0.0) == 0.0
    assert qn.direction(0.0, -2.0) == -0.5 * np.pi


@given(vectors, vectors)
def test_vector_algebra_agrees_with_numpy(u, v):
    assert qn.dot(u, v) == pytest.approx(np.dot(u, v), abs=1e-10)
    np.testing.assert_allclose(qn.cross(u, v), np.cross(u, v), atol=1e-10)
    np.testing.assert_array_equal(qn.add(u, v), np.add(u, v))
    np.testing.assert_array_equal(qn.subtract(u, v), np.subtract(u, v))
    assert qn.norm(u) == pytest.approx(np.linalg.norm(u), rel=1e-14)


@pytest.mark.parametrize("half_angle", [1e-9, 1e-4, 0.01, 0.03, 0.0499, 0.0501, 0.3])
def test_the_exponentials_series_is_exact_up_to_where_it_ends(half_angle):
    """At 0.05 rad the first term left out is 1e-15; the one before it would be 8e-13."""
    w, x, _, _ = qn.exp((2.0 * half_angle, 0.0, 0.0))
    assert w == pytest.approx(cos(half_angle), rel=0, abs=2e-15)
    assert x == pytest.approx(sin(half_angle), rel=2e-14, abs=0)
