"""The paper's parameters, and what perfect vehicles and random ones measure."""

import numpy as np

from estimator.filter.memberships import midpoint
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import Vectors
from estimator.geometry.quaternion import cross, rotate_inverse, unit
from estimator.live.settings import settings_of
from estimator.profile import load_profile

MAGNETIC = unit((1.0, -1.0, 1.0))
GRAVITY = (0.0, 0.0, 1.0)
PAPER = ReferenceParams(MAGNETIC, GRAVITY, 1.0, 1.0, 1.0)
FUZZY = settings_of(load_profile("paper")).filter._replace(memberships=midpoint())


def fixed(gain, **changes):
    return FUZZY._replace(gain_is_fixed=True, fixed_gain=float(gain), **changes)


def seen_from(q, measured=PAPER):
    """What a perfect vehicle of attitude ``q`` measures."""
    v1 = rotate_inverse(q, measured.magnetic_ned)
    v2 = rotate_inverse(q, measured.gravity_ned)
    s1, s2, s3 = measured.s_magnetic, measured.s_gravity, measured.s_cross
    return Vectors(v1, measured.magnetic_ned, s1, v2, measured.gravity_ned, s2, s3)


def three(q, truth, s):
    """Measured and estimated triples and M = sum s_i v_i v_i^T for exact measurements."""
    v = [rotate_inverse(truth, MAGNETIC), rotate_inverse(truth, GRAVITY)]
    u = [rotate_inverse(q, MAGNETIC), rotate_inverse(q, GRAVITY)]
    v.append(unit(cross(*v)))
    u.append(unit(cross(*u)))
    return v, u, sum(w * np.outer(x, x) for w, x in zip(s, v, strict=True))
