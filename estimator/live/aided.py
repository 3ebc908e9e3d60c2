"""The filter on conditioned vectors, with and without the help of velocity, compiled."""

from math import hypot
from typing import Any

from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import AidingState, North
from estimator.compilation.compiled import inlined
from estimator.conditioning.condition import Conditioned
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import REACH
from estimator.conditioning.rate import corrected_rate, slow_share
from estimator.filter.kernel import correct, turn_on
from estimator.filter.observation import ReferenceParams, weighted_vectors
from estimator.filter.types import FilterState, Vectors
from estimator.geometry.quaternion import conjugate, exp, log, multiply, rotate_inverse, scale
from estimator.types import Quaternion


@inlined
def conditioned_vectors(reference: ReferenceParams, seen: Conditioned) -> Vectors:
    """The conditioned directions with the profile's confidences.

    v1 is the heading's own horizontal north, so what disturbs the field has
    already been weighed; it counts from the first field on.
    """
    return weighted_vectors(
        reference,
        magnetic_frd=seen.magnetic_b,
        magnetic_share=1.0 if seen.has_heading else 0.0,
        gravity_frd=seen.gravity_b,
        gravity_share=1.0,
        weight=1.0,
    )


# Sigmas at which a vector's confidence is one half.
GRAVITY_HALF_RAD = 0.1
MAGNETIC_HALF_RAD = 0.2
# An aided vertical is lost when it is this much, and twice the unaided's sigma, uncertain.
LOST_RAD = 0.25


@inlined
def confidence(sigma_rad: float, half_rad: float) -> float:
    """1/(1 + (sigma/half)^2): 1 for a certain direction, and less for others."""
    return 1.0 / (1.0 + (sigma_rad / half_rad) ** 2)


@inlined
def horizontal_north(reference: ReferenceParams, knows_north: bool) -> North:
    """Magnetic north by the reference, which has none where the field is vertical."""
    m = reference.magnetic_ned
    horizontal = hypot(m[0], m[1])
    if knows_north and horizontal > 0.0:
        return North(True, (m[0] / horizontal, m[1] / horizontal))
    return North(False, (1.0, 0.0))


@inlined
def aided_vectors(handle: Any, weight: float) -> Vectors:
    """Both inertial directions as the aided attitude sees them; confidence falls with its sigma.

    While magnetic north is not known, the filter's north is where the horizontal field points.
    """
    reference, state = handle.params.reference, handle.aided
    knows_north = handle.now.knows_north or rolls(handle.params.aiding)
    q = state.estimate.q_ned_frd
    north = reference.magnetic_ned
    E = state.estimate.earth_gauss
    horizontal = hypot(E[0], E[1])
    if not knows_north and horizontal > NORM_SCALE * abs(E[2]):
        north = (E[0] / horizontal, E[1] / horizontal, 0.0)
    sigma = state.sigma
    return weighted_vectors(
        reference,
        magnetic_frd=rotate_inverse(q, north),
        magnetic_share=confidence(sigma.heading_rad, MAGNETIC_HALF_RAD),
        gravity_frd=rotate_inverse(q, reference.gravity_ned),
        gravity_share=confidence(sigma.inclination_rad, GRAVITY_HALF_RAD),
        weight=weight,
    )


@inlined
def is_worse(state: AidingState, seen: Conditioned) -> bool:
    """Whether the unaided stage knows the vertical much better: velocity does not help any more."""
    return state.sigma.inclination_rad > LOST_RAD + 2.0 * seen.sigma_inclination_rad


@inlined
def follow_aided(handle: Any, before: Quaternion) -> FilterState:
    """The filter propagated and corrected after the aiding's step from the attitude ``before``."""
    aided = handle.aided
    last, bias = aided.last, aided.estimate.gyr_bias_rad_s
    dt = last.dt_s
    slow = slow_share(dt)
    rate = last.rate_rad_s
    if slow > 0.0:  # the one that makes of the attitude before the step that after it
        expected = multiply(before, exp(scale(dt, rate)))
        correction = log(multiply(conjugate(expected), aided.estimate.q_ned_frd))
        rate = corrected_rate(rate, correction, slow, dt)
    state = turn_on(handle.filter, exp(scale(dt, rate)), rate, bias)
    # A slow stream's vectors are weighed already, and the filter must not keep what a step has
    # missed of a turn: with the least gain, 1/s, such a step is REACH time constants.
    weight = 1.0 + slow * REACH / dt if slow > 0.0 else 1.0
    return correct(handle.params.filter, state, aided_vectors(handle, weight), dt)
