"""Second-order Butterworth low-pass, exact for the time step at hand."""

from math import cos, exp, sin
from typing import NamedTuple

from estimator.compilation.compiled import inlined
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

    The poles are -(1 +- i)/tau, a Butterworth filter with the cut-off
    sqrt(2)/(2 pi tau), VQF's choice (Laidig and Seel 2023,
    doi 10.1016/j.inffus.2022.10.014). With x = y - u, w = tau y', a = dt/tau:
    x' = e^-a ((cos a + sin a) x + sin a w), w' = e^-a (-2 sin a x + (cos a - sin a) w).
    The state holds tau w instead of w: of an input that goes to and fro, tau^2 y' stays as it
    is when tau changes, and y' or w would leave a swing behind.
    The step is the solution itself, so no time step is unstable.
    """
    a = dt_s / tau_s
    e = exp(-a)
    c = e * cos(a)
    s = e * sin(a)
    return LowPass(c + s, s / tau_s, -2.0 * s * tau_s, c - s)


@inlined
def smooth_scalar(k: LowPass, y: float, w: float, u: float) -> tuple[float, float]:
    """One step for one channel: value and slope."""
    x = y - u
    return (u + k.own * x + k.cross * w, k.rate * w + k.pull * x)


@inlined
def smooth(k: LowPass, state: Smooth, u: Vec3) -> Smooth:
    """One step for a vector."""
    y0, w0 = smooth_scalar(k, state.value[0], state.slope[0], u[0])
    y1, w1 = smooth_scalar(k, state.value[1], state.slope[1], u[1])
    y2, w2 = smooth_scalar(k, state.value[2], state.slope[2], u[2])
    return Smooth((y0, y1, y2), (w0, w1, w2))


@inlined
def approach(mean: Vec3, v: Vec3, share: float) -> Vec3:
    """The mean moved by the share of its way to ``v``."""
    return (
        mean[0] + share * (v[0] - mean[0]),
        mean[1] + share * (v[1] - mean[1]),
        mean[2] + share * (v[2] - mean[2]),
    )
