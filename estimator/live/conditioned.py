"""The filter on conditioned vectors: what the ``imu`` profile runs, compiled."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.condition import condition
from estimator.conditioning.types import Conditioned, ConditioningParams, ConditioningState
from estimator.filter.kernel import correct, integrate_rate
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState, Vectors
from estimator.types import Vec3


@inlined
def conditioned_vectors(reference: ReferenceParams, seen: Conditioned) -> Vectors:
    """The conditioned directions with the profile's confidences.

    v1 is the heading's own horizontal north, so what disturbs the field has
    already been weighed; it counts from the first field on.
    """
    return Vectors(
        seen.magnetic_b,
        reference.magnetic_ned,
        reference.s_magnetic * seen.magnetic_weight,
        seen.gravity_b,
        reference.gravity_ned,
        reference.s_gravity * seen.gravity_weight,
        reference.s_cross * seen.gravity_weight,
    )


@inlined
def follow_conditioned(
    params: FilterParams,
    reference: ReferenceParams,
    state: FilterState,
    seen: Conditioned,
    dt: float,
) -> FilterState:
    """The filter propagated free of bias and corrected with the conditioned vectors."""
    state = integrate_rate(state, seen.rate_rad_s, dt, seen.bias_rad_s)
    return correct(params, state, conditioned_vectors(reference, seen), dt)


@inlined
def conditioned_step(
    params: FilterParams,
    reference: ReferenceParams,
    conditioning: ConditioningParams,
    state: FilterState,
    memory: ConditioningState,
    gyr_rad_s: Vec3,
    acc_m_s2: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt: float,
) -> tuple[FilterState, ConditioningState, Conditioned]:
    """One sample: condition it, propagate free of bias, correct with the conditioned vectors."""
    memory, seen = condition(conditioning, memory, gyr_rad_s, acc_m_s2, mag, has_mag, dt)
    return follow_conditioned(params, reference, state, seen, dt), memory, seen
