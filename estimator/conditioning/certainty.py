"""How far the conditioned vectors can be trusted: what a learning step leaves to be published."""

from math import inf

from estimator.compilation.compiled import inlined
from estimator.conditioning.magnetic import has_heading
from estimator.conditioning.rate import following_weight
from estimator.conditioning.sigma import sigma_heading, sigma_inclination
from estimator.conditioning.tilt import slowness
from estimator.conditioning.types import Certainty, ConditioningParams, ConditioningState

# Without a field for so long (s) there is no confidence in it any more.
FIELD_PATIENCE_S = 2.0


@inlined
def certainty_of(params: ConditioningParams, state: ConditioningState) -> Certainty:
    """All of it after a learning step: between two nothing that it depends on changes."""
    field, dt_s = state.magnetic, state.coefficients.dt_s
    known = has_heading(field)
    return Certainty(
        weight=following_weight(slowness(params, dt_s), dt_s),
        has_heading=known,
        gravity_confidence=1.0 / (1.0 + state.gravity.force.unsteady),
        magnetic_confidence=field.look.confidence if field.wait_s < FIELD_PATIENCE_S else 0.0,
        sigma_inclination_rad=sigma_inclination(params, state),
        sigma_heading_rad=sigma_heading(params, state) if known else inf,
    )


@inlined
def with_certainty(state: ConditioningState, certainty: Certainty) -> ConditioningState:
    """The same with another certainty; compiled code has to name all."""
    return ConditioningState(
        started=state.started,
        previous_gyr_rad_s=state.previous_gyr_rad_s,
        gathered=state.gathered,
        clipping=state.clipping,
        spin=state.spin,
        averaging=state.averaging,
        gravity=state.gravity,
        tilt=state.tilt,
        rest=state.rest,
        estimate=state.estimate,
        lagged=state.lagged,
        magnetic=state.magnetic,
        calibration=state.calibration,
        signs=state.signs,
        doubt=state.doubt,
        axes=state.axes,
        certainty=certainty,
        coefficients=state.coefficients,
    )
