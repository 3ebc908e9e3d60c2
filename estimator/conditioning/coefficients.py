"""What depends on the time step only."""

from math import exp

from estimator.compilation.compiled import inlined
from estimator.conditioning.lowpass import low_pass
from estimator.conditioning.types import Coefficients, ConditioningParams

BIAS_WALK_TIME_S = 100.0  # the time that ``bias_walk_rad_s`` refers to


@inlined
def coefficients(params: ConditioningParams, dt_s: float, factor: float) -> Coefficients:
    """With a random walk of V dt a step, noise P^2/(V dt) + P makes P the steady variance."""
    walk = params.bias_walk_rad_s**2 * dt_s / BIAS_WALK_TIME_S
    tau_s = params.gravity_tau_s * factor
    at_rest = params.bias_rest_sigma_rad_s**2
    moving = params.bias_motion_sigma_rad_s**2
    return Coefficients(
        dt_s=dt_s,
        factor=factor,
        rest=low_pass(params.rest_tau_s, dt_s),
        gravity=low_pass(tau_s, dt_s),
        gravity_share=1.0 - exp(-dt_s / tau_s),
        quick_share=1.0 - exp(-dt_s / params.turn_moving_tau_s),
        levelling_decay=exp(-dt_s / params.turn_levelling_tau_s),
        bias_growth=walk,
        rest_noise=at_rest * at_rest / walk + at_rest,
        motion_noise=moving * moving / walk + moving,
        heading_growth=params.heading_noise_rad2_s * dt_s / params.heading_tau_s**2,
    )
