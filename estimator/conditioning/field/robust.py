"""How much a measurement counts that is further off than its noise explains."""

from estimator.compilation.compiled import inlined

# The least confidence that anything is divided by: the noise of what nobody believes stays finite.
LEAST_CONFIDENCE = 1e-6
# A residual within so many sigmas (squared) of what is expected is none too far.
REACH_SQUARE = 9.0


@inlined
def robust_weight(square: float) -> float:
    """The weight 1/(1 + x^2)^2 of a deviation x, by its square.

    That of a robust estimator whose loss saturates (Geman and McClure 1987): far ones do not count.
    """
    return 1.0 / (1.0 + square) ** 2


@inlined
def residual_weight(residual: float, reach: float, variance: float) -> float:
    """The weight of a residual: a quarter at ``reach``, further out the larger its ``variance``."""
    return robust_weight(residual * residual / (reach * reach + REACH_SQUARE * variance))
