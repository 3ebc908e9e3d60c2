"""The steps of ``estimator/filter/reference.py`` on scalars, compiled, in the same order.

That file explains them, and takes K and the bias's gain from here. Equation numbers and labels are
those of the paper it names.
"""

from math import expm1, sqrt

import numpy as np

from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.filter.fuzzy import operating_gain
from estimator.filter.noise_gain import (
    confirmed_error,
    noise_gain,
    observe_floor,
    observe_noise,
    vector_error,
)
from estimator.filter.observation import ReferenceParams, raw_vectors
from estimator.filter.types import (
    COLLINEAR_SINE,
    PLAIN_STEP_LIMIT,
    STEP_TOLERANCE,
    FilterParams,
    FilterState,
    Vectors,
)
from estimator.geometry.quaternion import (
    add,
    cross,
    dot,
    exp,
    inverse_root,
    multiply,
    normalize,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import ZERO_VEC3, Floats, Quaternion, Sample, Vec3


@inlined
def innovation(v1: Vec3, u1: Vec3, s1: float, v2: Vec3, u2: Vec3, s2: float) -> Vec3:
    """sum s_i/2 (v_hat_i x v_i): vex(Pa(M R~)) of Eq. (11), of two vectors."""
    return add(scale(0.5 * s1, cross(u1, v1)), scale(0.5 * s2, cross(u2, v2)))


@inlined
def attitude_error(
    v1: Vec3, v2: Vec3, u1: Vec3, u2: Vec3, across: Vec3, inverse: float, cosine: float
) -> float:
    """e = (3 - Tr R~)/4, clipped to [0, 1], without the matrix inverse.

    With V = [v1 v2 v3] and U = [u1 u2 u3] the estimates, the paper's trace is Tr(V^-T U^T): each
    u_i against the dual vector of v_i. As v3 is the unit normal of v1 and v2, the duals are (v2 x
    c)/c^2, (c x v1)/c^2 and v3, with ``across`` c = v1 x v2, ``inverse`` 1/|c| and ``cosine`` that
    of v3 and u3.
    """
    plane = dot(cross(v2, across), u1) + dot(cross(across, v1), u2)
    trace = inverse * inverse * plane + cosine
    return min(1.0, max(0.0, 0.25 * (3.0 - trace)))


@inlined
def single_vector_error(v1: Vec3, v2: Vec3, u1: Vec3, u2: Vec3, s1: float, s2: float) -> float:
    """sin^2 of half the angle between the vectors, averaged by confidence."""
    total = s1 + s2
    if total <= 0.0:
        return 0.0
    return (s1 * vector_error(v1, u1) + s2 * vector_error(v2, u2)) / total


@inlined
def follow_rate(rate_1_s: float, change: float, dt: float, tau_s: float) -> float:
    """d_k = d_(k-1) + (e_k - e_(k-1) - dt d_(k-1))/(tau + dt); 1/s, signed."""
    return rate_1_s + 1.0 / (tau_s + dt) * (change - dt * rate_1_s)


@inlined
def error_rate(params: FilterParams, state: FilterState, error: float, dt: float) -> float:
    """The low-passed derivative of e, as before where there was no e or no time has passed."""
    d = state.error_rate_1_s
    if not state.has_error or dt <= 0.0:
        return d
    return follow_rate(d, error - state.error, dt, params.rate_time_constant_s)


@inlined
def adaptive_gain(params: FilterParams, error: float, error_rate_1_s: float) -> float:
    """K = 1 + k_op (below Eq. (12))."""
    if params.gain_is_fixed:
        return params.fixed_gain
    return 1.0 + operating_gain(params.memberships, error, error_rate_1_s)


@inlined
def largest_rate(cosine: float, s1: float, s2: float, s3: float) -> float:
    """Largest eigenvalue of (tr(M) I - M)/2: (tr M - smallest eigenvalue of M)/2.

    M has the eigenvalue s3 along v3 and, in the plane of v1 and v2,
    ((s1 + s2) +- sqrt((s1 - s2)^2 + 4 s1 s2 cos^2))/2.
    """
    total = s1 + s2
    if s3 <= 0.0:
        return 0.5 * total
    difference = s1 - s2
    in_plane = 0.5 * (total - sqrt(difference * difference + 4.0 * s1 * s2 * cosine * cosine))
    return 0.5 * (total + s3 - min(s3, in_plane))


@inlined
def step_gain(params: FilterParams, K: float, fastest: float, dt: float) -> float:
    """K dt for short steps; beyond, (1 - exp(-K lambda dt))/lambda, which never overshoots."""
    is_short = dt <= STEP_TOLERANCE * params.euler_step_max_s
    plain = is_short and K * fastest * dt <= PLAIN_STEP_LIMIT
    if plain or fastest <= 0.0:
        return K * dt
    return -expm1(-K * fastest * dt) / fastest


@inlined
def bias_gain(params: FilterParams, K: float, g: float, fastest: float, dt: float) -> float:
    """gamma/2 g/K: the innovation that the bias integrates decays over the step as the error does.

    At most 1/(lambda dt), with which the bias alone would explain the error: more would overshoot.
    """
    if params.gamma == 0.0:
        return 0.0
    gain = 0.5 * params.gamma * g / K
    reach = fastest * dt
    return gain if gain * reach <= 1.0 else 1.0 / reach


@inlined
def bound_each(v: Vec3, bound: float) -> Vec3:
    """Each component limited to [-bound, bound]."""
    return (
        min(bound, max(-bound, v[0])),
        min(bound, max(-bound, v[1])),
        min(bound, max(-bound, v[2])),
    )


@inlined
def turn_on(
    state: FilterState, turn: Quaternion, rate_rad_s: Vec3, gyr_bias_rad_s: Vec3
) -> FilterState:
    """The attitude turned on by what a rate has turned the body; rate and bias only recorded."""
    q = normalize(multiply(state.q_ned_frd, turn))
    return state._replace(q_ned_frd=q, gyr_bias_rad_s=gyr_bias_rad_s, rate_rad_s=rate_rad_s)


@compiled()
def propagate(state: FilterState, gyr_rad_s: Vec3, dt: float) -> FilterState:
    """R_hat <- R_hat exp([Omega_m - b_hat]x dt): Eq. (12), "Attit_Filter", without W."""
    rate = subtract(gyr_rad_s, state.gyr_bias_rad_s)
    return turn_on(state, exp(scale(dt, rate)), rate, state.gyr_bias_rad_s)


@compiled()
def correct(params: FilterParams, state: FilterState, vectors: Vectors, dt: float) -> FilterState:
    """R_hat <- R_hat exp(-[W]x dt), b_hat <- b_hat + gamma/2 vex(...) dt: W and b of Eq. (12).

    vex(...) is Eq. (11), "SO3_PPF_STCH_VEX_VM", with the estimates of Eq. (10).
    """
    v1, v2 = vectors.v1_frd, vectors.v2_frd
    u1 = rotate_inverse(state.q_ned_frd, vectors.v1_ned)
    u2 = rotate_inverse(state.q_ned_frd, vectors.v2_ned)
    s1, s2, s3 = vectors.s1, vectors.s2, 0.0
    w = innovation(v1, u1, s1, v2, u2, s2)
    knows_noise = params.gain_knows_noise and not params.gain_is_fixed
    noise, e, spans = state.noise, 0.0, False
    if vectors.s3 > 0.0 or not knows_noise:
        v_across, u_across = cross(v1, v2), cross(u1, u2)
        v_square, u_square = dot(v_across, v_across), dot(u_across, u_across)
        spans = min(s1, s2) > 0.0 and min(v_square, u_square) > COLLINEAR_SINE**2
        if spans:
            s3 = vectors.s3
            inverse = inverse_root(v_square)
            share = inverse * inverse_root(u_square)  # v3 and u3 are the unit normals
            cosine = share * dot(v_across, u_across)
            if s3 > 0.0:
                w = add(w, scale(0.5 * s3 * share, cross(u_across, v_across)))
            if not knows_noise:
                e = attitude_error(v1, v2, u1, u2, v_across, inverse, cosine)
    if knows_noise:
        noise, e = confirmed_error(noise, v1, u1, s1, v2, u2, s2)
    elif not spans:
        e = single_vector_error(v1, v2, u1, u2, s1, s2)
    d = error_rate(params, state, e, dt)
    if knows_noise:
        noise = observe_noise(noise, v1, s1 > 0.0, v2, s2 > 0.0, state.rate_rad_s, dt)
        noise = observe_floor(noise, e, dt)
        K = noise_gain(noise, e, params.rate_time_constant_s * d, state.gain, dt)
    else:
        K = adaptive_gain(params, e, d)
    fastest = largest_rate(dot(v1, v2), s1, s2, s3)
    g = step_gain(params, K, fastest, dt)
    q = normalize(multiply(state.q_ned_frd, exp(scale(-g, w))))
    b = add(state.gyr_bias_rad_s, scale(bias_gain(params, K, g, fastest, dt), w))
    b = bound_each(b, params.bias_bound_rad_s)
    return FilterState(q, b, e, d, K, True, state.rate_rad_s, noise)


@compiled()
def step(
    params: FilterParams, reference: ReferenceParams, state: FilterState, sample: Sample
) -> FilterState:
    """One sample of raw vectors: propagate, then correct."""
    vectors = raw_vectors(reference, sample.acc_m_s2, sample.mag, sample.has_mag)
    dt = sample.dt_s
    return correct(params, propagate(state, sample.gyr_rad_s, dt), vectors, dt)


def paper_arguments() -> tuple[FilterParams, ReferenceParams, FilterState]:
    """What a run begins with, as examples of their types."""
    params = FilterParams(*(0.0,) * 5, memberships=(0.0,) * 22, gain_is_fixed=False,
                          fixed_gain=0.0, gain_knows_noise=False)  # fmt: skip
    reference = ReferenceParams(*(ZERO_VEC3,) * 2, *(0.0,) * 3, place_gauss=ZERO_VEC3)
    return params, reference, FilterState()


@compiled(types=lambda: types_of(*paper_arguments(), *(np.zeros((1, 3)),) * 3, 0.0))
def run(
    params: FilterParams,
    reference: ReferenceParams,
    start: FilterState,
    gyr_rad_s: Floats,
    acc_m_s2: Floats,
    mag: Floats,
    dt: float,
) -> tuple[Floats, Floats]:
    """The paper's experiment: raw vectors at a fixed step, sample by sample as the live filter.

    Readings of the gyroscope and both vectors are (N, 3) in FRD: rad/s, m/s^2 and any unit of a
    field. Returns the estimates ``q_ned_frd`` before each correction (N, 4), which the paper's cost
    takes, and the gains K (N,).
    """
    n = len(gyr_rad_s)
    estimates = np.empty((n, 4))
    gains = np.empty(n)
    state = start
    step_s = params.first_step_s
    for k in range(n):
        if k > 0:
            step_s = dt
            state = propagate(state, (gyr_rad_s[k, 0], gyr_rad_s[k, 1], gyr_rad_s[k, 2]), dt)
        for i in range(4):
            estimates[k, i] = state.q_ned_frd[i]
        acc = (acc_m_s2[k, 0], acc_m_s2[k, 1], acc_m_s2[k, 2])
        field = (mag[k, 0], mag[k, 1], mag[k, 2])
        state = correct(params, state, raw_vectors(reference, acc, field, True), step_s)
        gains[k] = state.gain
    return estimates, gains
