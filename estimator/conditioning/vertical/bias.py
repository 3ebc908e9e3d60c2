"""Gyroscope bias and heading, estimated with one covariance."""

from math import radians
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import FAR, ConditioningParams
from estimator.conditioning.vertical.lowpass import Coefficients, Smooth, approach, smooth
from estimator.conditioning.vertical.stillness import RestState, Stillness
from estimator.geometry.axes import FrameAxes
from estimator.geometry.quaternion import dot, scale, subtract
from estimator.types import ZERO_VEC3, Vec2, Vec3

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
    k0, k1, k2, k3 = w * m0, w * m1, w * m2, w * m3
    p00, p01, p02, p03 = p00 - k0 * m0, p01 - k0 * m1, p02 - k0 * m2, p03 - k0 * m3
    p11, p12, p13 = p11 - k1 * m1, p12 - k1 * m2, p13 - k1 * m3
    p22, p23, p33 = p22 - k2 * m2, p23 - k2 * m3, p33 - k3 * m3
    x = (x[0] + s * m0, x[1] + s * m1, x[2] + s * m2)
    return x, x3 + s * m3, (p00, p01, p02, p03, p11, p12, p13, p22, p23, p33)


# No gyroscope of any use is biased by more; those of real quadrotors are by 4 deg/s.
MOST_BIAS_RAD_S = radians(10.0)
UNKNOWN_HEADING_VARIANCE = 1e4  # rad^2, beyond any angle: the first field sets the heading
# A heading with a smaller sigma (rad) is as good as its field, and linear formulas hold.
SETTLED_HEADING_RAD = 0.3


class Estimate(NamedTuple):
    """Gyro bias and heading of 6D, with the covariance of (bias, heading)."""

    bias_rad_s: Vec3  # of the gyroscope, FRD
    heading_rad: float  # by which 6D is turned about down to north
    covariance: Covariance  # (rad/s)^2 and rad^2


class Lagged(NamedTuple):
    """6D's level axes and the bias along them, low-passed as the gravity that levels 6D is."""

    north: Smooth = Smooth()  # 6D's first axis u, seen from the body
    east: Smooth = Smooth()  # 6D's second axis v
    drift: Smooth = Smooth()  # (u . b, v . b, 0) with the bias b, rad/s


def first_estimate(
    params: ConditioningParams, heading_rad: float = 0.0, variance: float = UNKNOWN_HEADING_VARIANCE
) -> Estimate:
    """The estimate for an unknown gyroscope, with a heading and that one's variance (rad^2)."""
    bias = params.bias_initial_sigma_rad_s**2
    covariance = (bias, 0.0, 0.0, 0.0, bias, 0.0, 0.0, bias, 0.0, variance)
    return Estimate(ZERO_VEC3, heading_rad, covariance)


@inlined
def inflate_heading(estimate: Estimate, variance: float) -> Estimate:
    """Raise the heading's variance (rad^2), so that the next residuals correct it."""
    p = estimate.covariance
    return estimate._replace(covariance=(*p[:9], p[9] + variance))


@inlined
def clip(x: float, limit: float) -> float:
    """``x`` limited to [-limit, limit]."""
    return max(-limit, min(limit, x))


@inlined
def clip_each(b: Vec3, before: Vec3) -> Vec3:
    """Each component of a bias within ``MOST_BIAS_RAD_S``; where it was beyond, no further."""
    return (
        clip(b[0], max(MOST_BIAS_RAD_S, abs(before[0]))),
        clip(b[1], max(MOST_BIAS_RAD_S, abs(before[1]))),
        clip(b[2], max(MOST_BIAS_RAD_S, abs(before[2]))),
    )


@inlined
def predict(
    params: ConditioningParams,
    k: Coefficients,
    estimate: Estimate,
    down: Vec3,
    turning: float,
    unseen: float,
) -> Estimate:
    """Covariance over one step: F P F' + Q with heading' = heading - dt down . (b_true - b).

    The heading correction undoes the turn that a bias error gives to the 6D frame about ``down``,
    its third axis seen from the body, so the field's heading also shows the bias over time. The
    bias walks until its variance is the initial one. Q has a constant part and one that grows with
    the squared rate ``turning``, as scale errors turn motion into drift. ``unseen`` (rad^2) is what
    a slow step adds.
    """
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = estimate.covariance
    dt = k.dt_s
    g0, g1, g2 = scale(-dt, down)
    # P_bb g
    b0 = p00 * g0 + p01 * g1 + p02 * g2
    b1 = p01 * g0 + p11 * g1 + p12 * g2
    b2 = p02 * g0 + p12 * g1 + p22 * g2
    p33 += 2.0 * (g0 * p03 + g1 * p13 + g2 * p23) + g0 * b0 + g1 * b1 + g2 * b2
    p33 += k.heading_growth + params.heading_turning_noise_s * turning * dt + unseen
    if params.use_joint_covariance:
        p03 += b0
        p13 += b1
        p23 += b2
    most = params.bias_initial_sigma_rad_s**2
    p00 += k.bias_growth if p00 < most else 0.0
    p11 += k.bias_growth if p11 < most else 0.0
    p22 += k.bias_growth if p22 < most else 0.0
    return estimate._replace(covariance=(p00, p01, p02, p03, p11, p12, p13, p22, p23, p33))


@inlined
def learn_at_rest(
    params: ConditioningParams,
    k: Coefficients,
    estimate: Estimate,
    axes: FrameAxes,
    rest: RestState,
    still: Stillness,
) -> Estimate:
    """At rest the low-passed gyro is the bias: three updates with innovation g_lp - b.

    The slow turn that gravity and field show, ``still.turning``, is subtracted. What they leave
    open is an error as long as a rest. A gyroscope that errs about the level ``axes`` by more than
    expected may err as much about any other.
    """
    g = subtract(rest.gyr.value, still.turning)
    b, d, p = estimate
    steps = params.rest_time_s / k.dt_s
    level = k.rest_noise + still.level_variance * steps
    off = subtract(g, b)
    squared = 0.5 * (dot(off, axes.north) ** 2 + dot(off, axes.east) ** 2)
    if squared > FAR * params.bias_initial_sigma_rad_s**2:
        p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = p
        p = (p00 + squared, p01, p02, p03, p11 + squared, p12, p13, p22 + squared, p23, p33)
    b, d, p = update(b, d, p, axes.north, 0.0, dot(axes.north, subtract(g, b)), level)
    b, d, p = update(b, d, p, axes.east, 0.0, dot(axes.east, subtract(g, b)), level)
    noise = k.rest_noise + still.down_variance * steps
    b, d, p = update(b, d, p, axes.down, 0.0, dot(axes.down, subtract(g, b)), noise)
    return Estimate(clip_each(b, estimate.bias_rad_s), d, p)


@inlined
def lag(
    params: ConditioningParams,
    k: Coefficients,
    state: Lagged,
    axes: FrameAxes,
    b: Vec3,
    age_s: float,
    share: float,
    slow: float,
) -> Lagged:
    """Low-pass 6D's level ``axes``, and the bias along them, as gravity was low-passed.

    A levelling step undoes what the bias did while the present gravity was averaged. Like
    gravity's, whose age is ``age_s``, the low-pass begins with a running mean; it moves by
    ``share`` of its way if ``slow`` is above 0.
    """
    u, v = axes.north, axes.east
    drift = (dot(u, b), dot(v, b), 0.0)
    warm_up = age_s <= params.gravity_tau_s
    if warm_up or slow > 0.0:
        a = max(k.dt_s / age_s, slow * share) if warm_up else share
        return Lagged(
            Smooth(approach(state.north.value, u, a), state.north.slope),
            Smooth(approach(state.east.value, v, a), state.east.slope),
            Smooth(approach(state.drift.value, drift, a), state.drift.slope),
        )
    return Lagged(
        smooth(k.gravity, state.north, u),
        smooth(k.gravity, state.east, v),
        smooth(k.gravity, state.drift, drift),
    )


@inlined
def learn_in_motion(
    params: ConditioningParams,
    k: Coefficients,
    estimate: Estimate,
    lagged: Lagged,
    step: Vec2,
    unseen: float,
) -> Estimate:
    """While moving, what levelling keeps undoing is the bias.

    Two updates with 6D's level axes u: -step/dt + (u . b)_lp - u_lp . b, since a bias error turns
    the 6D frame by R6 (b_true - b) and levelling turns it back. ``unseen``, (rad/s)^2, is the noise
    of a slow step's missed turn. Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    axes, drift = (lagged.north.value, lagged.east.value), lagged.drift.value
    b, d, p = estimate
    most = params.bias_limit_rad_s
    for i in range(2):
        e = clip(-step[i] / k.dt_s + drift[i] - dot(axes[i], estimate.bias_rad_s), most)
        # that is the innovation of the bias before the step: less what the other axis has changed
        e -= dot(axes[i], subtract(b, estimate.bias_rad_s))
        b, d, p = update(b, d, p, axes[i], 0.0, e, k.motion_noise + unseen)
    return Estimate(clip_each(b, estimate.bias_rad_s), d, p)
