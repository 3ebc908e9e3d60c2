"""Kalman updates of three values and a fourth, by one scalar measurement at a time."""

from estimator.compilation.compiled import inlined
from estimator.types import Vec3

# Upper triangle, row by row, of the covariance of three values and a fourth.
Covariance = tuple[float, float, float, float, float, float, float, float, float, float]


@inlined
def update(
    x: Vec3, x3: float, p: Covariance, h: Vec3, h3: float, innovation: float, noise: float
) -> tuple[Vec3, float, Covariance]:
    """The values and their covariance after a measurement h . x + h3 x3 of variance ``noise``.

    With m = P h: x <- x + m innovation/(h . m + noise), P <- P - m m'/(h . m + noise).
    """
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = p
    m0 = p00 * h[0] + p01 * h[1] + p02 * h[2] + p03 * h3
    m1 = p01 * h[0] + p11 * h[1] + p12 * h[2] + p13 * h3
    m2 = p02 * h[0] + p12 * h[1] + p22 * h[2] + p23 * h3
    m3 = p03 * h[0] + p13 * h[1] + p23 * h[2] + p33 * h3
    w = 1.0 / (h[0] * m0 + h[1] * m1 + h[2] * m2 + h3 * m3 + noise)
    s = w * innovation
    k0 = w * m0
    k1 = w * m1
    k2 = w * m2
    k3 = w * m3
    return (
        (x[0] + s * m0, x[1] + s * m1, x[2] + s * m2),
        x3 + s * m3,
        (
            p00 - k0 * m0,
            p01 - k0 * m1,
            p02 - k0 * m2,
            p03 - k0 * m3,
            p11 - k1 * m1,
            p12 - k1 * m2,
            p13 - k1 * m3,
            p22 - k2 * m2,
            p23 - k2 * m3,
            p33 - k3 * m3,
        ),
    )
