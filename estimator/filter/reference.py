"""The filter as the paper reads, with small matrices: one function a step.

A. Singh, T. S. Sieb, J. H. Howe, H. A. Hashim, "Nonlinear Attitude Filter on SO(3): Fast Adaptation
and Robustness", 2021. Equations are cited by the number that the paper prints and by the label in
its source. Its structure is that of R. Mahony, T. Hamel and J.-M. Pflimlin, IEEE Trans. Automatic
Control 53(5), 2008, doi:10.1109/TAC.2008.923738. docs/paper.md has what the paper leaves open.

The vehicle turns with dR/dt = R [Omega]x, Eq. (6) "Attit_R_Dynamics", and its gyroscope reads
Omega_m = Omega + b + n, Eq. (7) "Attit_Angular". The filter, Eq. (12) "Attit_Filter", turns R_hat
with Omega_m - b_hat - W. W draws the estimated directions R_hat^T v_i^I to the measured ones v_i^B;
fuzzy rules set its gain K from the distance e between the two frames and its rate of change. e is
what the measurements show of |R~|_I = Tr(I - R~)/4, with R~ = R^T R_hat of Eq. (8) "Attit_R_error":
sin^2 of half the angle between truth and estimate.

``estimator/filter/kernel.py`` holds the same steps on scalars, compiled, in the same order. K and
the bias's gain are plain numbers in either form, and come from there.
"""

from typing import Any

import numpy as np

from estimator.filter.kernel import adaptive_gain, bias_gain
from estimator.filter.noise_gain import NoiseState, noise_gain, observe_floor, observe_noise
from estimator.filter.types import (
    COLLINEAR_SINE,
    PLAIN_STEP_LIMIT,
    STEP_TOLERANCE,
    FilterParams,
    FilterState,
    Vectors,
)
from estimator.geometry import quaternion
from estimator.types import Floats, Quaternion, Vec3


def rotation_matrix(q: Quaternion) -> Floats:
    """R with v_a = R v_b for q = q_ab."""
    columns = [
        quaternion.rotate(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]
    return np.array(columns).T


def three_vectors(v: Vectors, q: Quaternion) -> tuple[Floats, Floats, Floats, bool]:
    """Measured v_i, estimated v_hat_i = R_hat^T v_i^I as (3, 3) rows, and confidences s_i (3,).

    Eq. (10), "SO3_PPF_STCH_vB_hat"; v3 = v1 x v2, normalised like the others.
    The last value shows whether v1 and v2 span a plane.
    """
    R = rotation_matrix(q)
    measured = [np.array(v.v1_frd), np.array(v.v2_frd)]
    inertial = [np.array(v.v1_ned), np.array(v.v2_ned)]
    cross_measured = np.cross(measured[0], measured[1])
    cross_inertial = np.cross(inertial[0], inertial[1])
    sine, inertial_sine = np.linalg.norm(cross_measured), np.linalg.norm(cross_inertial)
    spans = bool(min(v.s1, v.s2) > 0.0 and min(sine, inertial_sine) > COLLINEAR_SINE)
    if spans:
        measured.append(cross_measured / sine)
        inertial.append(cross_inertial / inertial_sine)
    else:
        measured.append(np.zeros(3))
        inertial.append(np.zeros(3))
    s = np.array([v.s1, v.s2, v.s3 if spans else 0.0])
    return np.array(measured), np.array(inertial) @ R, s, spans


def innovation(measured: Floats, estimated: Floats, s: Floats) -> Floats:
    """vex(Pa(M R~)) = sum_i s_i/2 (v_hat_i x v_i): Eq. (11), "SO3_PPF_STCH_VEX_VM"."""
    return np.asarray(np.sum(0.5 * s[:, None] * np.cross(estimated, measured), axis=0))


def attitude_error(measured: Floats, estimated: Floats, s: Floats) -> float:
    """e = (3 - Tr R~)/4 from measurements, clipped to [0, 1].

    Tr R~ = Tr{(sum s_i v_i v_i^T)^-1 sum s_i v_i v_hat_i^T}, unnumbered, after Eq. (11).
    The confidences cancel as long as none is zero, so a zero one counts as 1.
    """
    weights = np.where(s > 0.0, s, 1.0)
    A = np.einsum("i,ij,ik->jk", weights, measured, measured)
    B = np.einsum("i,ij,ik->jk", weights, measured, estimated)
    trace = np.trace(np.linalg.solve(A, B))
    return float(np.clip((3.0 - trace) / 4.0, 0.0, 1.0))


def single_vector_error(measured: Floats, estimated: Floats, s: Floats) -> float:
    """sin^2 of half the angle between the vectors, averaged by confidence."""
    half_angle_sine_sq = 0.5 * (1.0 - np.sum(measured[:2] * estimated[:2], axis=1))
    total = s[0] + s[1]
    return float(np.clip(s[:2] @ half_angle_sine_sq / total, 0.0, 1.0)) if total > 0.0 else 0.0


def confirmed_error(
    noise: NoiseState, measured: Floats, estimated: Floats, s: Floats
) -> tuple[NoiseState, float]:
    """The same, of each vector the smaller one of this sample and of the one before."""
    now = np.clip(0.5 * (1.0 - np.sum(measured[:2] * estimated[:2], axis=1)), 0.0, 1.0)
    now = np.where(s[:2] > 0.0, now, noise.errors)
    total = float(s[0] + s[1])
    e = float(np.dot(s[:2], np.minimum(now, noise.errors))) / total if total > 0.0 else 0.0
    return noise._replace(errors=(float(now[0]), float(now[1]))), e


def error_rate(params: FilterParams, state: FilterState, error: float, dt: float) -> float:
    """d_k = d_(k-1) + dt/(tau + dt) ((e_k - e_(k-1))/dt - d_(k-1)), d_0 = 0; 1/s, signed."""
    if not state.has_error or dt <= 0.0:
        return state.error_rate_1_s
    d = state.error_rate_1_s
    return d + dt / (params.rate_time_constant_s + dt) * ((error - state.error) / dt - d)


def largest_rate(measured: Floats, s: Floats) -> float:
    """Largest eigenvalue of (tr(M) I - M)/2, M = sum s_i v_i v_i^T.

    A small error about its axis decays with K times it; about no axis faster.
    """
    M = np.einsum("i,ij,ik->jk", s, measured, measured)
    return float(np.linalg.eigvalsh(0.5 * (np.trace(M) * np.eye(3) - M))[-1])


def step_gain(params: FilterParams, K: float, fastest: float, dt: float) -> float:
    """K dt for short steps; beyond, (1 - exp(-K lambda dt))/lambda, which never overshoots."""
    is_short = dt <= STEP_TOLERANCE * params.euler_step_max_s
    plain = is_short and K * fastest * dt <= PLAIN_STEP_LIMIT
    if plain or fastest <= 0.0:
        return K * dt
    return float(-np.expm1(-K * fastest * dt) / fastest)


def propagate(state: FilterState, gyr_rad_s: Vec3, dt: float) -> FilterState:
    """R_hat <- R_hat exp([Omega_m - b_hat]x dt): Eq. (12), "Attit_Filter", without W."""
    rate = quaternion.subtract(gyr_rad_s, state.gyr_bias_rad_s)
    q = quaternion.multiply(state.q_ned_frd, quaternion.exp(quaternion.scale(dt, rate)))
    return state._replace(q_ned_frd=quaternion.normalize(q), rate_rad_s=rate)


def correct(params: FilterParams, state: FilterState, vectors: Vectors, dt: float) -> FilterState:
    """R_hat <- R_hat exp(-[W]x dt), W = K vex(...), db/dt = gamma/2 vex(...): Eq. (12).

    ``dt`` is the time since the previous sample, for the first ``FilterParams.first_step_s``. At 0
    the error and the gain are set and nothing moves.
    """
    measured, estimated, s, spans = three_vectors(vectors, state.q_ned_frd)
    w = innovation(measured, estimated, s)
    if params.gain_knows_noise and not params.gain_is_fixed:
        state, e, d, K = gain_in_noise(params, state, measured, estimated, s, dt)
    else:
        e = (attitude_error if spans else single_vector_error)(measured, estimated, s)
        d = error_rate(params, state, e, dt)
        K = adaptive_gain(params, e, d)
    return moved(params, state, w, largest_rate(measured, s), e, d, K, dt)


def gain_in_noise(
    params: FilterParams,
    state: FilterState,
    measured: Floats,
    estimated: Floats,
    s: Floats,
    dt: float,
) -> tuple[FilterState, float, float, float]:
    """State with the measured noise, e, its rate, and K: see :mod:`estimator.filter.noise_gain`."""
    noise, e = confirmed_error(state.noise, measured, estimated, s)
    d = error_rate(params, state, e, dt)
    v1, v2 = ((float(x), float(y), float(z)) for x, y, z in measured[:2])
    noise = observe_noise(noise, v1, s[0] > 0.0, v2, s[1] > 0.0, state.rate_rad_s, dt)
    noise = observe_floor(noise, e, dt)
    K = noise_gain(noise, e, params.rate_time_constant_s * d, state.gain, dt)
    return state._replace(noise=noise), e, d, K


def moved(
    params: FilterParams,
    state: FilterState,
    w: Floats,
    fastest: float,
    e: float,
    d: float,
    K: float,
    dt: float,
) -> FilterState:
    """The innovation ``w`` (3,) at work on attitude and bias: Eq. (12), "Attit_Filter"."""
    g = step_gain(params, K, fastest, dt)
    turn: Any = tuple(-g * w)
    q = quaternion.multiply(state.q_ned_frd, quaternion.exp(turn))
    b = np.array(state.gyr_bias_rad_s) + bias_gain(params, K, g, fastest, dt) * w
    b = np.clip(b, -params.bias_bound_rad_s, params.bias_bound_rad_s)
    return state._replace(
        q_ned_frd=quaternion.normalize(q),
        gyr_bias_rad_s=(float(b[0]), float(b[1]), float(b[2])),
        error=e,
        error_rate_1_s=d,
        gain=K,
        has_error=True,
    )
