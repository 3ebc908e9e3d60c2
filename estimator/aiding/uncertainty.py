"""How far off the aided attitude may be: the angle that 68 % of the errors lie under."""

from math import hypot, sqrt

from estimator.aiding.inertial import Prediction
from estimator.aiding.types import (
    ACC_BIAS,
    HARD_IRON,
    IMU_LAG,
    TURN,
    Agreements,
    AidingParams,
    Array,
    FieldState,
    Scatter,
    Sigmas,
)
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import (
    NORM_SCALE,
    deviation,
    horizontal_down,
    norm_of,
    robust_factor,
)
from estimator.conditioning.params import REACH, SPAN_S
from estimator.geometry.metrics import PLANE_68
from estimator.geometry.quaternion import norm
from estimator.types import Vec3


@inlined
def sigmas(
    params: AidingParams, now: Prediction, field: FieldState, agreement: Agreements
) -> Sigmas:
    """How uncertain the estimate is after a sample."""
    P, scale = now.covariance, scatter_scale(params, agreement)
    late_rad = sqrt(max(0.0, P[IMU_LAG, IMU_LAG])) * norm(now.rate_rad_s)  # from turning only
    level = inclination_variance(params, P, scale)
    heading = heading_variance(params, now, scale, field)
    return Sigmas(sqrt(level + late_rad * late_rad), sqrt(heading + late_rad * late_rad))


@inlined
def inclination_variance(params: AidingParams, P: Array, scale: float) -> float:
    """By the covariance, as far as the scatter ``scale`` confirms it.

    Reports show nothing of what the accelerometer's bias may have turned, however well they agree.
    """
    scale *= params.colour
    variance = 0.5 * (P[TURN, TURN] + P[TURN + 1, TURN + 1])
    by_bias = 0.0
    for k in range(ACC_BIAS, ACC_BIAS + 3):
        together = P[TURN, k] ** 2 + P[TURN + 1, k] ** 2
        by_bias += 0.5 * together / max(P[k, k], TINY)
    inclination: float = PLANE_68**2 * max(scale * scale * variance, min(by_bias, variance))
    return inclination


@inlined
def heading_variance(
    params: AidingParams, now: Prediction, scale: float, field: FieldState
) -> float:
    """By the covariance and the field's slow disagreement: either may be wrong.

    A heading that is no more certain than hard iron may turn the field comes from the field, so the
    reports' agreement does not count.
    """
    if field.samples == 0.0:
        scale *= params.colour  # by velocity only
    E = now.estimate.earth_gauss
    heading: float = now.covariance[TURN + 2, TURN + 2]
    # how far the hard iron of a calibrated compass may turn the field
    iron_rad = params.hard_iron_sigma_gauss / max(hypot(E[0], E[1]), NORM_SCALE * abs(E[2]), TINY)
    by_field = min(1.0, heading / max(iron_rad * iron_rad, 1e-12))
    square = scale * scale
    square += (1.0 - min(1.0, square)) * by_field
    return square * heading + field.off_rad**2


@inlined
def with_dip_error(
    params: AidingParams, sigma: Sigmas, field: FieldState, place_gauss: Vec3, P: Array
) -> Sigmas:
    """The sigmas with how far the field's dip, seen level, differs from the place's.

    This shows a vertical that an accelerometer has turned, even if reports and gyroscope have come
    to agree with it. A field of another norm points to a magnet instead. Hard iron is not counted.
    """
    place = horizontal_down(place_gauss)
    n = norm_of(place)
    if n == 0.0 or field.samples == 0.0:
        return sigma
    off_norm, off_dip = deviation((field.look.horizontal, field.look.down), place)
    iron = REACH**2 * P[HARD_IRON, HARD_IRON] / (n * n)
    square = max(0.0, off_dip * off_dip - params.field_dip_scale_rad**2 - iron)
    square /= robust_factor((off_norm / NORM_SCALE) ** 2)
    return sigma._replace(inclination_rad=hypot(sigma.inclination_rad, sqrt(square)))


@inlined
def unexplained(scatter: Scatter) -> float:
    """The least share by which the variance exceeds the covariance's.

    Innovations of a filter whose covariance is right are white. If its variance were 1 + u times
    that covariance, a share x of the innovations', their mean square would be 1 + x u and
    the mean product of one and the next x (1 - x) u (R. K. Mehra 1970, IEEE Trans. Autom. Control
    15, 175). The square of that over this is at most 4/27 u. A small excess counts less: jitter
    makes such, too.
    """
    together = max(0.0, scatter.together)
    u = 6.75 * together * together / max(scatter.innovation, 1e-12)
    return u * min(1.0, u)


@inlined
def scatter_scale(params: AidingParams, agreement: Agreements) -> float:
    """The scatter of reports, relative to what the covariance expects; at least 1 without reports.

    The covariance is that of the roughest IMU and the poorest reports. Less scatter shows less
    uncertainty, but an autopilot's filter integrates the same IMU, so its agreement proves only so
    much. A receiver does not know the IMU: whatever its innovations share with the one before is
    not noise.
    """
    by_filter, by_receiver = agreement.by_filter, agreement.by_receiver
    scatter = by_filter.scatter if by_filter.wait_s <= by_receiver.wait_s else by_receiver.scatter
    square = params.least_scale**2 + params.scatter_share * scatter.innovation
    if by_receiver.wait_s <= SPAN_S:
        square = max(square, unexplained(by_receiver.scatter))
    if min(by_filter.wait_s, by_receiver.wait_s) > SPAN_S:
        square = max(square, 1.0)
    return min(sqrt(square), REACH)
