"""Gyroscope bias and heading, estimated with one covariance."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.lowpass import smooth_scalar
from estimator.conditioning.types import (
    Coefficients,
    ConditioningParams,
    Covariance,
    Estimate,
    Lagged,
    RestState,
    Rows,
    Two,
)
from estimator.geometry.quaternion import dot
from estimator.types import Vec3

Four = tuple[float, float, float, float]


@inlined
def clip(x: float, limit: float) -> float:
    """X limited to [-limit, limit]."""
    return max(-limit, min(limit, x))


@inlined
def clip_each(b: Vec3, limit: float) -> Vec3:
    """Each component within the limit."""
    return (clip(b[0], limit), clip(b[1], limit), clip(b[2], limit))


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

    The heading correction has to undo the turn that a bias error gives to the
    6D frame about down, the third row of R6. So the field's heading, over time
    and attitudes, also says what the bias is, with the right weight. The bias
    walks until its variance is back at the initial one. Q has a constant part
    and one that grows with the squared rate ``turning``: a gyroscope's scale
    errors turn motion into drift. ``unseen`` (rad^2) is what a slow step adds.
    """
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = estimate.covariance
    dt = k.dt_s
    g0 = -dt * down[0]
    g1 = -dt * down[1]
    g2 = -dt * down[2]
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
    covariance = (p00, p01, p02, p03, p11, p12, p13, p22, p23, p33)
    return Estimate(estimate.bias_rad_s, estimate.heading_rad, covariance)


@inlined
def update(
    x: Vec3, x3: float, p: Covariance, h: Vec3, h3: float, innovation: float, noise: float
) -> tuple[Vec3, float, Covariance]:
    """Kalman update by one scalar h . x + h3 x3 of variance ``noise``."""
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = p
    m0 = p00 * h[0] + p01 * h[1] + p02 * h[2] + p03 * h3
    m1 = p01 * h[0] + p11 * h[1] + p12 * h[2] + p13 * h3
    m2 = p02 * h[0] + p12 * h[1] + p22 * h[2] + p23 * h3
    m3 = p03 * h[0] + p13 * h[1] + p23 * h[2] + p33 * h3
    w = 1.0 / (h[0] * m0 + h[1] * m1 + h[2] * m2 + h3 * m3 + noise)
    return corrected(x, x3, p, (m0, m1, m2, m3), w, innovation)


@inlined
def update_last(
    x: Vec3, x3: float, p: Covariance, innovation: float, noise: float
) -> tuple[Vec3, float, Covariance]:
    """The same by x3 alone."""
    m = (p[3], p[6], p[8], p[9])
    return corrected(x, x3, p, m, 1.0 / (p[9] + noise), innovation)


@inlined
def corrected(
    x: Vec3, x3: float, p: Covariance, m: Four, w: float, innovation: float
) -> tuple[Vec3, float, Covariance]:
    """The update's second half: m = P h, and w the inverse of the innovation's variance."""
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = p
    m0, m1, m2, m3 = m
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


@inlined
def learn_at_rest(
    params: ConditioningParams, k: Coefficients, estimate: Estimate, rest: RestState
) -> Estimate:
    """At rest the low-passed gyro is the bias: three updates with innovation g_lp - b."""
    g = rest.gyr.value
    b, d, p = estimate.bias_rad_s, estimate.heading_rad, estimate.covariance
    most = params.bias_limit_rad_s
    b, d, p = update(b, d, p, (1.0, 0.0, 0.0), 0.0, clip(g[0] - b[0], most), k.rest_noise)
    b, d, p = update(b, d, p, (0.0, 1.0, 0.0), 0.0, clip(g[1] - b[1], most), k.rest_noise)
    b, d, p = update(b, d, p, (0.0, 0.0, 1.0), 0.0, clip(g[2] - b[2], most), k.rest_noise)
    return Estimate(clip_each(b, most), d, p)


@inlined
def start_lag(state: Lagged, u: Vec3, v: Vec3, drift: Two, a: float) -> Lagged:
    """The running mean that starts :func:`lag`."""
    r = state.rows
    e = state.drift
    rows = (
        r[0] + a * (u[0] - r[0]),
        r[1] + a * (u[1] - r[1]),
        r[2] + a * (u[2] - r[2]),
        r[3] + a * (v[0] - r[3]),
        r[4] + a * (v[1] - r[4]),
        r[5] + a * (v[2] - r[5]),
    )
    mean = (e[0] + a * (drift[0] - e[0]), e[1] + a * (drift[1] - e[1]))
    return Lagged(rows=rows, rows_slope=state.rows_slope, drift=mean, drift_slope=state.drift_slope)


@inlined
def lag(
    params: ConditioningParams,
    k: Coefficients,
    state: Lagged,
    rows: Rows,
    b: Vec3,
    age_s: float,
    share: float,
    slow: float,
) -> Lagged:
    """Low-pass the horizontal rows of R6, and R6 b, as gravity was: levelling belongs to them."""
    u, v = rows.north, rows.east
    drift = (dot(u, b), dot(v, b))
    if age_s <= params.gravity_tau_s:
        return start_lag(state, u, v, drift, max(k.dt_s / age_s, slow * share))
    if slow > 0.0:
        return start_lag(state, u, v, drift, share)
    r, w = state.rows, state.rows_slope
    y0, w0 = smooth_scalar(k.gravity, r[0], w[0], u[0])
    y1, w1 = smooth_scalar(k.gravity, r[1], w[1], u[1])
    y2, w2 = smooth_scalar(k.gravity, r[2], w[2], u[2])
    y3, w3 = smooth_scalar(k.gravity, r[3], w[3], v[0])
    y4, w4 = smooth_scalar(k.gravity, r[4], w[4], v[1])
    y5, w5 = smooth_scalar(k.gravity, r[5], w[5], v[2])
    z0, v0 = smooth_scalar(k.gravity, state.drift[0], state.drift_slope[0], drift[0])
    z1, v1 = smooth_scalar(k.gravity, state.drift[1], state.drift_slope[1], drift[1])
    return Lagged(
        rows=(y0, y1, y2, y3, y4, y5),
        rows_slope=(w0, w1, w2, w3, w4, w5),
        drift=(z0, z1),
        drift_slope=(v0, v1),
    )


@inlined
def learn_in_motion(
    params: ConditioningParams,
    k: Coefficients,
    estimate: Estimate,
    lagged: Lagged,
    step: Two,
    unseen: float,
) -> Estimate:
    """While moving, what levelling keeps undoing is the bias.

    Two updates with the horizontal rows: -step/dt + (R6 b)_lp - R_lp b, since a
    bias error turns the 6D frame by R6 (b_true - b) and levelling turns it
    back. ``unseen``, (rad/s)^2, is what a slow step's missed turn adds to their
    noise. Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    r = lagged.rows
    north = (r[0], r[1], r[2])
    east = (r[3], r[4], r[5])
    b, d, p = estimate.bias_rad_s, estimate.heading_rad, estimate.covariance
    most = params.bias_limit_rad_s
    e1 = clip(-step[0] / k.dt_s + lagged.drift[0] - dot(north, b), most)
    e2 = clip(-step[1] / k.dt_s + lagged.drift[1] - dot(east, b), most)
    b1, d1, p1 = update(b, d, p, north, 0.0, e1, k.motion_noise + unseen)
    # the second innovation is still that of b: take off what the first update changed
    e2 -= dot(east, b1) - dot(east, b)
    b2, d2, p2 = update(b1, d1, p1, east, 0.0, e2, k.motion_noise + unseen)
    return Estimate(clip_each(b2, most), d2, p2)
