"""The filter on vectors conditioned with the help of velocity reports, compiled."""

from math import hypot

from estimator.aiding import AidingParams, AidingState, Report, aid
from estimator.aiding.types import Array
from estimator.compilation.compiled import inlined
from estimator.conditioning.magnetic import LEAST_HORIZONTAL
from estimator.filter.kernel import correct, integrate_rate
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState, Vectors
from estimator.geometry.quaternion import rotate_inverse
from estimator.types import Vec3

# Sigmas at which a vector's confidence is one half.
GRAVITY_HALF_RAD = 0.1
MAGNETIC_HALF_RAD = 0.2


@inlined
def confidence(sigma_rad: float, half_rad: float) -> float:
    """From 1 for a certain direction towards 0: 1/(1 + (sigma/half)^2)."""
    return 1.0 / (1.0 + (sigma_rad / half_rad) ** 2)


@inlined
def aided_vectors(reference: ReferenceParams, state: AidingState, knows_north: bool) -> Vectors:
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
        reference.s_magnetic * confidence(state.sigma_heading_rad, MAGNETIC_HALF_RAD),
        rotate_inverse(q, reference.gravity_ned),
        reference.gravity_ned,
        reference.s_gravity * confidence(state.sigma_inclination_rad, GRAVITY_HALF_RAD),
        reference.s_cross,
    )


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
    state = integrate_rate(state, aided.rate_rad_s, dt, aided.gyr_bias_rad_s)
    state = correct(params, state, aided_vectors(reference, aided, knows_north), dt)
    return state, aided, covariance
