"""What follows from the parameters and the time step, and is kept until the step changes."""

from math import exp
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import LONG_S, QUICK_S, SPAN_S, USUAL_S
from estimator.conditioning.vertical.lowpass import LowPass, low_pass


class Coefficients(NamedTuple):
    """The coefficients of steps of one length; none before the first step."""

    dt_s: float = 0.0  # the time step
    factor: float = 1.0  # of the averaging time of the published vertical
    rest: LowPass = LowPass()  # of gyroscope and accelerometer, with ``QUICK_S``
    gravity: LowPass = LowPass()  # with ``gravity_tau_s``
    best: LowPass = LowPass()  # with that times the factor
    gravity_share: float = 0.0  # of a step in a mean over that time
    quick_share: float = 0.0  # of a step in a mean over ``SPAN_S``
    bias_growth: float = 0.0  # of a bias's variance in a step, (rad/s)^2
    rest_noise: float = 0.0  # variance of a bias seen at rest, (rad/s)^2
    motion_noise: float = 0.0  # variance of a bias seen by levelling, (rad/s)^2
    heading_growth: float = 0.0  # of the heading's variance in a step, rad^2


@inlined
def coefficients(params: ConditioningParams, dt_s: float, factor: float) -> Coefficients:
    """The coefficients of steps of ``dt_s``, with the published vertical's ``factor``.

    The noises are those that keep a variance where it shall be: with a random walk of variance V
    a step, a measurement of the noise P^2/V + P makes P the steady variance.
    """
    walk = params.bias_motion_sigma_rad_s**2 * dt_s / LONG_S
    tau_s = params.gravity_tau_s
    at_rest = params.bias_rest_sigma_rad_s**2
    moving = params.bias_motion_sigma_rad_s**2
    return Coefficients(
        dt_s=dt_s,
        factor=factor,
        rest=low_pass(QUICK_S, dt_s),
        gravity=low_pass(tau_s, dt_s),
        best=low_pass(factor * tau_s, dt_s),
        gravity_share=1.0 - exp(-dt_s / tau_s),
        quick_share=1.0 - exp(-dt_s / SPAN_S),
        bias_growth=walk,
        rest_noise=at_rest * at_rest / walk + at_rest,
        motion_noise=moving * moving / walk + moving,
        heading_growth=params.heading_noise_rad2_s * dt_s / USUAL_S**2,
    )
