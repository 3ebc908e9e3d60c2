"""Second-order Butterworth low-pass, exact for the time step at hand, and other coefficients.

They follow from the parameters and the time step, and are kept until the step changes.
"""

from math import cos, exp, sin
from typing import NamedTuple

import numpy as np

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import LONG_S, QUICK_S, SPAN_S, USUAL_S, ConditioningParams
from estimator.geometry.quaternion import add, scale, subtract
from estimator.types import ZERO_VEC3, Vec3


class LowPass(NamedTuple):
    """Coefficients for one time step."""

    own: float = 0.0  # of the value in the new value
    cross: float = 0.0  # of the slope in the new value, 1/s
    pull: float = 0.0  # of the value in the new slope, s
    rate: float = 0.0  # of the slope in the new slope


class Smooth(NamedTuple):
    """A low-passed vector and its scaled derivative, in the input's unit and frame."""

    value: Vec3 = ZERO_VEC3
    slope: Vec3 = ZERO_VEC3  # tau^2 times d/dt, unit times s


@inlined
def low_pass(tau_s: float, dt_s: float) -> LowPass:
    """Coefficients of tau^2 y'' + 2 tau y' + 2 y = 2 u over a step with constant u.

    The poles are -(1 +- i)/tau, a Butterworth filter with the cut-off sqrt(2)/(2 pi tau), VQF's
    choice (Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014). With x = y - u, w = tau y', a =
    dt/tau: x' = e^-a ((cos a + sin a) x + sin a w), w' = e^-a (-2 sin a x + (cos a - sin a) w). The
    step is the solution itself, so no time step is unstable. The state holds tau w, which stays as
    it is when tau changes under an input that goes to and fro; y' or w would leave a swing behind.
    """
    a = dt_s / tau_s
    e = exp(-a)
    c = e * cos(a)
    s = e * sin(a)
    return LowPass(c + s, s / tau_s, -2.0 * s * tau_s, c - s)


@inlined
def smooth(k: LowPass, state: Smooth, u: Vec3) -> Smooth:
    """One step with the vector ``u``."""
    x, w = subtract(state.value, u), state.slope
    value = add(add(u, scale(k.own, x)), scale(k.cross, w))
    return Smooth(value, add(scale(k.rate, w), scale(k.pull, x)))


@inlined
def approach(mean: Vec3, v: Vec3, share: float) -> Vec3:
    """The mean moved by the share of its way to ``v``."""
    return (
        mean[0] + share * (v[0] - mean[0]),
        mean[1] + share * (v[1] - mean[1]),
        mean[2] + share * (v[2] - mean[2]),
    )


def largest_between(quick_s: float, slow_s: float) -> float:
    """The largest part of a step that lies between two first-order low-passes.

    exp(-t/slow) - exp(-t/quick) is largest where both exponentials fall alike.
    """
    ratio = slow_s / quick_s
    return float(ratio ** (-1.0 / (ratio - 1.0)) * (1.0 - 1.0 / ratio))


def largest_lead(mean_s: float, tau_s: float) -> float:
    """The largest part of a step by which a first-order low-pass is ahead of :func:`low_pass`.

    It is the largest e^-x (cos x + sin x) - e^(-t/mean), with x = t/tau.
    """
    t = np.linspace(0.0, 4.0 * tau_s, 10_000)
    x = t / tau_s
    return float(np.max(np.exp(-x) * (np.cos(x) + np.sin(x)) - np.exp(-t / mean_s)))


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
    tau_s, at_rest = params.gravity_tau_s, params.bias_rest_sigma_rad_s**2
    moving = params.bias_motion_sigma_rad_s**2
    walk = moving * dt_s / LONG_S
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
