"""How much a measurement counts that is further off than its noise explains."""

from math import radians

from estimator.compilation.compiled import inlined

# A residual within so many sigmas of what is expected is none too far.
REACH = 3.0
# A squared residual this many times its variance (4 sigma) is no noise: chance reaches it once in
# an hour of independent seconds.
FAR = 16.0
# A residual of the heading that counts a quarter, rad. Small: a wrong heading never returns, large:
# magnets draw it. The aiding does not begin with a less certain heading, by velocity or by field.
HEADING_REACH_RAD = radians(25.0)
# A vector that is off its mean by this share of its size has been turned, not measured badly; one
# that differs by less from what an attitude predicts is explained by it.
MOST_DEVIATION = 0.6


@inlined
def robust_factor(square: float) -> float:
    """Factor (1 + x^2)^2 of the noise's variance for a deviation x, from the square of x.

    The inverse is the weight of a robust estimator whose loss saturates (Geman and McClure 1987):
    deviations that are far off do not count.
    """
    return (1.0 + square) ** 2


@inlined
def residual_factor(residual: float, variance: float) -> float:
    """Factor of the noise of a heading's residual: 4 at :data:`HEADING_REACH_RAD`.

    A larger ``variance`` (rad^2) of the heading moves that point out: its error explains the
    residual.
    """
    return robust_factor(residual * residual / (HEADING_REACH_RAD**2 + REACH**2 * variance))
