"""How far the attitude was turned where the gyroscope felt no turn, and whether that was expected.

If the filter's model is true, its corrections are white and their sum over half a minute has the
variance that the covariance loses. An accelerometer that steps, a compass learnt wrong or wrong
velocities turn the attitude by many times that, while the covariance shrinks all the same. Until
that sum is forgotten, the attitude may be wrong by it.
"""

from math import e, hypot, sqrt
from math import exp as real_exp

from estimator.aiding.types import (
    GYR_BIAS,
    TURN,
    AidingEstimate,
    AidingParams,
    Array,
    CorrectionCusum,
    Sigmas,
)
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import MEMORY_S
from estimator.geometry.quaternion import add, rotate, scale, subtract
from estimator.types import Vec2, Vec3

# Their sum is within two sigmas of what is expected.
MOST_SQUARE = 4.0


@inlined
def known(P: Array) -> Vec2:
    """The attitude's variances (rad^2): about north and east together, and about down."""
    return P[TURN, TURN] + P[TURN + 1, TURN + 1], P[TURN + 2, TURN + 2]


@inlined
def pass_time(
    params: AidingParams, cusum: CorrectionCusum, estimate: AidingEstimate, P: Array, dt: float
) -> CorrectionCusum:
    """Corrections ``dt`` older. An unexpected bias has turned the attitude, too.

    Such a bias becomes expected with time. One that began with a larger sigma than biases have is
    still being learnt, and becomes expected as far as it is known better than ever before.
    """
    keep = real_exp(-dt / MEMORY_S)
    variance = P[GYR_BIAS, GYR_BIAS]
    variance += P[GYR_BIAS + 1, GYR_BIAS + 1] + P[GYR_BIAS + 2, GYR_BIAS + 2]
    expected = 3.0 * params.gyr_bias_sigma**2
    before = max(expected, cusum.least_variance)
    least = max(expected, min(variance, before))
    bias_prior = least / before
    change = subtract(estimate.gyr_bias_rad_s, cusum.bias_rad_s)
    turned = scale(-dt, rotate(estimate.q_ned_frd, change))
    return CorrectionCusum(
        turn_rad=add(scale(keep, cusum.turn_rad), turned),
        bias_rad_s=add(cusum.bias_rad_s, scale(1.0 - keep * bias_prior, change)),
        least_variance=least,
        level=keep * keep * cusum.level,
        heading=keep * keep * cusum.heading,
    )


@inlined
def add_correction(
    cusum: CorrectionCusum, turn_rad: Vec3, before: Vec2, after: Vec2
) -> CorrectionCusum:
    """One more correction (NED), which has brought the variances down."""
    return cusum._replace(
        turn_rad=add(cusum.turn_rad, turn_rad),
        level=cusum.level + max(0.0, before[0] - after[0]),
        heading=cusum.heading + max(0.0, before[1] - after[1]),
    )


@inlined
def with_unexpected_turn(sigma: Sigmas, cusum: CorrectionCusum, P: Array) -> Sigmas:
    """The sigmas with what the corrections have turned beyond their expected variance.

    A bias that changes at once turns the attitude by at most ``MEMORY_S``/e of that before its mean
    has followed.
    """
    by_bias = (MEMORY_S / e) ** 2 / 3.0
    by_bias *= P[GYR_BIAS, GYR_BIAS] + P[GYR_BIAS + 1, GYR_BIAS + 1] + P[GYR_BIAS + 2, GYR_BIAS + 2]
    north, east, down = cusum.turn_rad
    level = north * north + east * east
    level -= MOST_SQUARE * (cusum.level + 2.0 * by_bias)
    heading = down * down - MOST_SQUARE * (cusum.heading + by_bias)
    return Sigmas(
        inclination_rad=hypot(sigma.inclination_rad, sqrt(max(0.0, level))),
        heading_rad=hypot(sigma.heading_rad, sqrt(max(0.0, heading))),
    )
