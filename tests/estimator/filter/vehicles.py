"""The paper's parameters, and what perfect vehicles and random ones measure."""

import numpy as np

from estimator.filter.memberships import midpoint
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, Vectors
from estimator.geometry.quaternion import cross, rotate_inverse, unit
from tests.vocabulary import random_unit_vector

MAGNETIC = unit((1.0, -1.0, 1.0))
GRAVITY = (0.0, 0.0, 1.0)
PAPER = ReferenceParams(MAGNETIC, GRAVITY, 1.0, 1.0, 1.0)
FUZZY = FilterParams(
    gamma=1.0,
    bias_bound_rad_s=2.0,
    rate_time_constant_s=0.3,
    euler_step_max_s=0.01,
    first_step_s=0.01,
    memberships=midpoint(),
    gain_is_fixed=False,
    fixed_gain=1.0,
    gain_knows_noise=False,
)
RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 50, 99, 100, 101, 200, 400)
GAINS = (1, 2, 5, 10, 20, 50, 70, 101)
GAPS_S = (0.0115, 0.05, 0.5, 1.0, 7.0, 60.0)


def fixed(gain, **changes):
    return FUZZY._replace(gain_is_fixed=True, fixed_gain=float(gain), **changes)


def seen_from(q, measured=PAPER):
    """What a perfect vehicle of attitude ``q`` measures."""
    v1 = rotate_inverse(q, measured.magnetic_ned)
    v2 = rotate_inverse(q, measured.gravity_ned)
    s1, s2, s3 = measured.s_magnetic, measured.s_gravity, measured.s_cross
    return Vectors(v1, measured.magnetic_ned, s1, v2, measured.gravity_ned, s2, s3)


def random_vectors(rng):
    """Measured and inertial directions that need not fit each other, with any confidences."""
    s1, s2, s3 = (rng.uniform(0.0, 5.0, 3) * (rng.random(3) < 0.8)).tolist()
    v = [random_unit_vector(rng) for _ in range(4)]
    return Vectors(v[0], v[1], s1, v[2], v[3], s2, s3)


def vex(A):
    return np.array([A[2, 1], A[0, 2], A[1, 0]])


def three(q, truth, s):
    """Measured and estimated triples and M = sum s_i v_i v_i^T for exact measurements."""
    v = [rotate_inverse(truth, MAGNETIC), rotate_inverse(truth, GRAVITY)]
    u = [rotate_inverse(q, MAGNETIC), rotate_inverse(q, GRAVITY)]
    v.append(unit(cross(*v)))
    u.append(unit(cross(*u)))
    return v, u, sum(w * np.outer(x, x) for w, x in zip(s, v, strict=True))
