"""The filter on conditioned vectors: what the ``imu`` profile runs without velocity, compiled."""

from estimator.compilation.compiled import inlined
from estimator.conditioning import Conditioned
from estimator.filter.kernel import correct, turn_on
from estimator.filter.observation import ReferenceParams, weighted_vectors
from estimator.filter.types import FilterParams, FilterState, Vectors


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
        weight=seen.weight,
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
    state = turn_on(state, seen.turn, seen.rate_rad_s, seen.bias_rad_s)
    return correct(params, state, conditioned_vectors(reference, seen), dt)
