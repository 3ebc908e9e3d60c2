"""How much a measurement counts that is further off than its noise explains."""

from estimator.compilation.compiled import inlined

# The least confidence that anything is divided by: the noise of what nobody believes stays finite.
LEAST_CONFIDENCE = 1e-6
# A residual within so many sigmas (squared) of what is expected is none too far.
REACH_SQUARE = 9.0


@inlined
def robust_factor(square: float) -> float:
    """By what (1 + x^2)^2 the noise's variance of a deviation x grows, from the square of x.

    The inverse is the weight of a robust estimator whose loss saturates (Geman and McClure 1987):
    deviations that are far off do not count.
    """
    return (1.0 + square) ** 2


@inlined
def residual_factor(residual: float, reach: float, variance: float) -> float:
    """By what a residual's noise grows: 4 times at ``reach``, further out the larger ``variance``.

    ``variance`` is that of the value itself: a residual that its error explains is none too far.
    """
    return robust_factor(residual * residual / (reach * reach + REACH_SQUARE * variance))
