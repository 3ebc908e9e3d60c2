"""How wrong an attitude is, and the paper's cost.

Errors as in the evaluation of BROAD (D. Laidig et al., 2021, doi:10.3390/data6070072): the error
quaternion is taken in the earth frame; its part about the vertical is the heading error, the rest
inclination.
"""

from math import atan2, sqrt
from typing import NamedTuple

import numpy as np

from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.geometry.quaternion import conjugate, multiply
from estimator.types import Floats, Quaternion

# The paper's cost, Eq. (15) "Cost_function": 0.3 sum_{0<=t<=1} e + sum_{4<=t<=14} e; steps of
# 0.01 s, both ends included.
COST_RATE_HZ = 100.0
COST_SAMPLES = 1501
TRANSIENT_WEIGHT = 0.3
TRANSIENT = slice(0, 101)
STEADY = slice(400, 1401)


# 68 % of a plane normal distribution lie within this many of its sigmas.
PLANE_68 = 1.515


class AngleErrors(NamedTuple):
    """Total, heading and inclination error, rad, each 0..pi."""

    total_rad: float
    heading_rad: float
    inclination_rad: float


@inlined
def angle_errors(q_estimate: Quaternion, q_reference: Quaternion) -> AngleErrors:
    """Errors between two attitudes of the same frames, z of the inertial frame vertical.

    total = 2 acos|w|, heading = 2 atan|z/w|, inclination = 2 acos sqrt(w^2 + z^2)
    of q_estimate q_reference*; written with atan2, which keeps small angles exact.
    """
    w, x, y, z = multiply(q_estimate, conjugate(q_reference))
    tilt = sqrt(x * x + y * y)
    return AngleErrors(
        2.0 * atan2(sqrt(x * x + y * y + z * z), abs(w)),
        2.0 * atan2(abs(z), abs(w)),
        2.0 * atan2(tilt, sqrt(w * w + z * z)),
    )


def batch_angle_errors(estimate: Floats, reference: Floats) -> Floats:
    """:func:`angle_errors` for (N, 4) quaternions: (N, 3) rad."""
    errors: Floats = _errors_of(writable(estimate), writable(reference))
    return errors


def writable(values: Floats) -> Floats:
    """The array, copied where it is constant or not contiguous: kernels have one form for it."""
    return np.require(values, requirements=("C", "W"))


@compiled(types=lambda: types_of(np.zeros((1, 4)), np.zeros((1, 4))))
def _errors_of(estimate: Floats, reference: Floats) -> Floats:
    errors = np.empty((len(estimate), 3))
    for k in range(len(estimate)):
        p = estimate[k]
        q = reference[k]
        one = angle_errors((p[0], p[1], p[2], p[3]), (q[0], q[1], q[2], q[3]))
        errors[k, 0] = one.total_rad
        errors[k, 1] = one.heading_rad
        errors[k, 2] = one.inclination_rad
    return errors


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def paper_cost(e: Floats) -> float:
    """J of Eq. (15), "Cost_function", from e at t = 0.01 k, k = 0..1500.

    Raises:
        ValueError: when ``e`` does not hold the experiment's 1501 samples.
    """
    if e.shape != (COST_SAMPLES,):
        raise ValueError(
            f"the paper's cost takes {COST_SAMPLES} errors, got an array of shape {e.shape}"
        )
    return float(TRANSIENT_WEIGHT * e[TRANSIENT].sum() + e[STEADY].sum())
