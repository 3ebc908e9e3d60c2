"""Second-order Butterworth low-pass, exact for the time step at hand."""

from math import cos, exp, sin

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import LowPass, Smooth
from estimator.types import Vec3


@inlined
def low_pass(tau_s: float, dt_s: float) -> LowPass:
    """Coefficients of tau^2 y'' + 2 tau y' + 2 y = 2 u over a step with constant u.

    The poles are -(1 +- i)/tau, a Butterworth filter with the cut-off
    sqrt(2)/(2 pi tau), VQF's choice (Laidig and Seel 2023,
    doi 10.1016/j.inffus.2022.10.014). With x = y - u, w = tau y', a = dt/tau:
    x' = e^-a ((cos a + sin a) x + sin a w), w' = e^-a (-2 sin a x + (cos a - sin a) w).
    The state holds tau w instead of w: of an input that goes to and fro, tau^2 y' stays the
    same when tau changes, and y' or w would leave a swing behind.
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
def running_mean(state: Smooth, u: Vec3, weight: float) -> Smooth:
    """The value moved by ``weight`` of the way to ``u``, at no slope."""
    y = state.value
    return Smooth(
        (
            y[0] + weight * (u[0] - y[0]),
            y[1] + weight * (u[1] - y[1]),
            y[2] + weight * (u[2] - y[2]),
        ),
        (0.0, 0.0, 0.0),
    )
