"""Gyroscope bias and heading, estimated with one covariance."""

from estimator.compiled import compiled
from estimator.conditioning.lowpass import smooth_scalar
from estimator.conditioning.types import (
    BiasState,
    Coefficients,
    ConditioningParams,
    Covariance,
    GravityState,
    RestState,
)
from estimator.quaternion import dot
from estimator.types import Vec3


@compiled
def clip(x: float, limit: float) -> float:
    """X limited to [-limit, limit]."""
    return max(-limit, min(limit, x))


@compiled
def predict(
    params: ConditioningParams, k: Coefficients, state: BiasState, third_row: Vec3, dt_s: float
) -> BiasState:
    """Covariance over one step: F P F' + Q with heading' = heading - dt r3 (b_true - b).

    The heading correction has to undo the turn that a bias error gives to the
    6D frame about the vertical, whose row in R6 is r3. So the field's heading,
    over time and attitudes, also says what the bias is, and says it with the
    right weight. The bias walks until its variance is back at the initial one.
    """
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = state.covariance
    g0 = -dt_s * third_row[0]
    g1 = -dt_s * third_row[1]
    g2 = -dt_s * third_row[2]
    # rows of P_bb g
    b0 = p00 * g0 + p01 * g1 + p02 * g2
    b1 = p01 * g0 + p11 * g1 + p12 * g2
    b2 = p02 * g0 + p12 * g1 + p22 * g2
    d = 2.0 * (g0 * p03 + g1 * p13 + g2 * p23) + g0 * b0 + g1 * b1 + g2 * b2
    p33 += d + k.heading_growth
    if params.use_joint_covariance:
        p03 += b0
        p13 += b1
        p23 += b2
    most = params.bias_initial_sigma_rad_s**2
    p00 += k.bias_growth if p00 < most else 0.0
    p11 += k.bias_growth if p11 < most else 0.0
    p22 += k.bias_growth if p22 < most else 0.0
    covariance = (p00, p01, p02, p03, p11, p12, p13, p22, p23, p33)
    return BiasState(
        state.bias_rad_s,
        state.heading_rad,
        covariance,
        state.rows,
        state.rows_slope,
        state.drift,
        state.drift_slope,
    )


@compiled
def update(
    b: Vec3, heading: float, p: Covariance, h: Vec3, h3: float, innovation: float, noise: float
) -> tuple[Vec3, float, Covariance]:
    """Kalman update with one scalar: innovation of h b + h3 heading, of variance ``noise``."""
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
        (b[0] + s * m0, b[1] + s * m1, b[2] + s * m2),
        heading + s * m3,
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


@compiled
def limited(b: Vec3, limit: float) -> Vec3:
    """Each component within the limit."""
    return (clip(b[0], limit), clip(b[1], limit), clip(b[2], limit))


@compiled
def learn_at_rest(
    params: ConditioningParams, k: Coefficients, state: BiasState, rest: RestState
) -> BiasState:
    """At rest the low-passed gyro is the bias: three updates with innovation g_lp - b."""
    g = rest.gyr.value
    b, d, p = state.bias_rad_s, state.heading_rad, state.covariance
    most = params.bias_limit_rad_s
    b, d, p = update(b, d, p, (1.0, 0.0, 0.0), 0.0, clip(g[0] - b[0], most), k.rest_noise)
    b, d, p = update(b, d, p, (0.0, 1.0, 0.0), 0.0, clip(g[1] - b[1], most), k.rest_noise)
    b, d, p = update(b, d, p, (0.0, 0.0, 1.0), 0.0, clip(g[2] - b[2], most), k.rest_noise)
    return BiasState(
        limited(b, most), d, p, state.rows, state.rows_slope, state.drift, state.drift_slope
    )


@compiled
def smooth_rows(
    params: ConditioningParams,
    k: Coefficients,
    state: BiasState,
    gravity: GravityState,
    row1: Vec3,
    row2: Vec3,
    dt_s: float,
) -> BiasState:
    """Low-pass the horizontal rows of R6, and R6 b, as gravity was: they belong to its lag."""
    b = state.bias_rad_s
    d1 = dot(row1, b)
    d2 = dot(row2, b)
    r, w = state.rows, state.rows_slope
    e, v = state.drift, state.drift_slope
    u = (row1[0], row1[1], row1[2], row2[0], row2[1], row2[2])
    if gravity.age_s <= params.gravity_tau_s:
        a = dt_s / gravity.age_s
        rows = (
            r[0] + a * (u[0] - r[0]),
            r[1] + a * (u[1] - r[1]),
            r[2] + a * (u[2] - r[2]),
            r[3] + a * (u[3] - r[3]),
            r[4] + a * (u[4] - r[4]),
            r[5] + a * (u[5] - r[5]),
        )
        drift = (e[0] + a * (d1 - e[0]), e[1] + a * (d2 - e[1]))
        return BiasState(b, state.heading_rad, state.covariance, rows, w, drift, v)
    y0, w0 = smooth_scalar(k.gravity, r[0], w[0], u[0])
    y1, w1 = smooth_scalar(k.gravity, r[1], w[1], u[1])
    y2, w2 = smooth_scalar(k.gravity, r[2], w[2], u[2])
    y3, w3 = smooth_scalar(k.gravity, r[3], w[3], u[3])
    y4, w4 = smooth_scalar(k.gravity, r[4], w[4], u[4])
    y5, w5 = smooth_scalar(k.gravity, r[5], w[5], u[5])
    z0, v0 = smooth_scalar(k.gravity, e[0], v[0], d1)
    z1, v1 = smooth_scalar(k.gravity, e[1], v[1], d2)
    return BiasState(
        b,
        state.heading_rad,
        state.covariance,
        (y0, y1, y2, y3, y4, y5),
        (w0, w1, w2, w3, w4, w5),
        (z0, z1),
        (v0, v1),
    )


@compiled
def learn_in_motion(
    params: ConditioningParams, k: Coefficients, state: BiasState, gravity: GravityState
) -> BiasState:
    """While moving, what levelling keeps undoing is the bias.

    Two updates with the horizontal rows: -levelling + (R6 b)_lp - R_lp b, since
    a bias error turns the 6D frame by R6 (b_true - b) and levelling turns it
    back. Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    r = state.rows
    row1 = (r[0], r[1], r[2])
    row2 = (r[3], r[4], r[5])
    b, d, p = state.bias_rad_s, state.heading_rad, state.covariance
    most = params.bias_limit_rad_s
    rate = gravity.levelling_rate_rad_s
    e1 = clip(-rate[0] + state.drift[0] - dot(row1, b), most)
    e2 = clip(-rate[1] + state.drift[1] - dot(row2, b), most)
    b1, d1, p1 = update(b, d, p, row1, 0.0, e1, k.motion_noise)
    # the second innovation is still that of b: take off what the first update changed
    e2 -= dot(row2, b1) - dot(row2, b)
    b2, d2, p2 = update(b1, d1, p1, row2, 0.0, e2, k.motion_noise)
    return BiasState(
        limited(b2, most), d2, p2, state.rows, state.rows_slope, state.drift, state.drift_slope
    )
