"""The filter on vectors conditioned with the help of velocity reports, compiled."""

from math import hypot

from estimator.aiding import AidingParams, AidingState, Report, aid
from estimator.aiding.types import Array
from estimator.compilation.compiled import inlined
from estimator.conditioning.magnetic import LEAST_HORIZONTAL
from estimator.conditioning.rate import following_weight, slow_share
from estimator.filter.kernel import correct, integrate_rate
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState, Vectors
from estimator.geometry.quaternion import conjugate, exp, log, multiply, rotate_inverse, scale
from estimator.types import Quaternion, Vec3

# Sigmas at which a vector's confidence is one half.
GRAVITY_HALF_RAD = 0.1
MAGNETIC_HALF_RAD = 0.2


@inlined
def confidence(sigma_rad: float, half_rad: float) -> float:
    """From 1 for a certain direction towards 0: 1/(1 + (sigma/half)^2)."""
    return 1.0 / (1.0 + (sigma_rad / half_rad) ** 2)


@inlined
def aided_vectors(
    reference: ReferenceParams, state: AidingState, knows_north: bool, weight: float
) -> Vectors:
    """Both inertial directions seen from the aided attitude; confidence falls with its sigma.

    While magnetic north is not known, what the filter calls north is where the field points.
    """
    q = state.q_ned_frd
    north = reference.magnetic_ned
    E = state.earth_gauss
    horizontal = hypot(E[0], E[1])
    if not knows_north and horizontal > LEAST_HORIZONTAL * abs(E[2]):
        north = (E[0] / horizontal, E[1] / horizontal, 0.0)
    return Vectors(
        rotate_inverse(q, north),
        reference.magnetic_ned,
        reference.s_magnetic * weight * confidence(state.sigma_heading_rad, MAGNETIC_HALF_RAD),
        rotate_inverse(q, reference.gravity_ned),
        reference.gravity_ned,
        reference.s_gravity * weight * confidence(state.sigma_inclination_rad, GRAVITY_HALF_RAD),
        reference.s_cross * weight,
    )


@inlined
def agreed_rate(before: Quaternion, state: AidingState, slow: float, dt: float) -> Vec3:
    """The rate that makes of the aided attitude before a slow step the one after it.

    exp(w' dt) = exp(w dt) exp(phi), as the unaided stage has it.
    """
    turn = exp(scale(dt, state.rate_rad_s))
    phi = log(multiply(conjugate(multiply(before, turn)), state.q_ned_frd))
    return scale(1.0 / dt, log(multiply(turn, exp(scale(slow, phi)))))


@inlined
def aided_step(
    params: FilterParams,
    reference: ReferenceParams,
    aiding: AidingParams,
    state: FilterState,
    aided: AidingState,
    covariance: Array,
    gravity_b: Vec3,
    gyr_rad_s: Vec3,
    acc_m_s2: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt: float,
    report: Report,
    knows_north: bool,
) -> tuple[FilterState, AidingState, Array]:
    """One sample: the filter follows the aided vectors; ``gravity_b`` is the unaided stage's."""
    m = reference.magnetic_ned
    horizontal = hypot(m[0], m[1])
    north = (0.0, 0.0)
    if knows_north and horizontal > 0.0:
        north = (m[0] / horizontal, m[1] / horizontal)
    before = aided.q_ned_frd
    aided, covariance = aid(
        aiding,
        aided,
        covariance,
        gravity_b,
        north,
        gyr_rad_s,
        acc_m_s2,
        mag,
        has_mag,
        dt,
        report,
    )
    slow = slow_share(dt)
    rate = aided.rate_rad_s if slow == 0.0 else agreed_rate(before, aided, slow, dt)
    state = integrate_rate(state, rate, dt, aided.gyr_bias_rad_s)
    weight = following_weight(slow, dt)
    state = correct(params, state, aided_vectors(reference, aided, knows_north, weight), dt)
    return state, aided, covariance
