"""Multiplicative extended Kalman filter on the paper's signals, another family of filter.

Attitude error in the body frame, the gyroscope's bias, and a constant error of each vector in the
body frame: 12 states. The vectors are taken with their length. Where a sample's
innovation is far larger than it should be, the attitude's covariance begins anew. C candidates run
on S seeds side by side: covariances are (C, S, n, n).

Source: F. L. Markley, "Attitude error representations for Kalman filtering", Journal of Guidance,
Control, and Dynamics 26(2), 2003, doi 10.2514/2.5048.
"""

import numpy as np
from common.paper_filter import Signals, exponential, matrices
from common.paper_laws import scales
from common.recordings import Array

from drivers.simulation.simulated_vehicle import FIELD_GAUSS
from estimator.live.settings import Settings
from estimator.types import STANDARD_GRAVITY_M_S2
from tuning.calibration.spans import cross_matrix
from tuning.space import Space

# Densities and sigmas; ``reset`` is the squared innovation over its variance, per measurement.
LOWER, UPPER = (0.02, 0.02, 0.3, 0.01, 2.0, 0.01), (2.0, 0.5, 4.0, 1.0, 100.0, 0.5)
FILTERS: dict[str, Space] = {
    "MEKF, vectors' biases modelled": scales(
        "gyroscope vectors attitude bias reset vector_bias", LOWER, UPPER
    ),
}


def mekf_errors(settings: Settings, on: Signals, candidates: Array) -> Array:
    """The true e (C, S, N) before each correction; candidates (C, D) as in :data:`FILTERS`."""
    p = np.asarray(candidates).T[:, :, None]  # (D, C, 1)
    n, dt = 12, 1.0 / on.rate_hz
    shape = (p.shape[1], len(on.truth))
    v = np.concatenate([on.mag_gauss / FIELD_GAUSS, -on.acc_m_s2 / STANDARD_GRAVITY_M_S2], axis=2)
    inertial = np.array([settings.reference.magnetic_ned, settings.reference.gravity_ned])
    R = np.broadcast_to(matrices(np.array(settings.initial)), (*shape, 3, 3))
    x, P = np.zeros((*shape, n)), np.zeros((*shape, n, n))
    diagonal = np.arange(n)
    sigmas = [p[2]] * 3 + [p[3]] * 3 + [p[-1]] * (n - 6)
    P[..., diagonal, diagonal] = np.stack([s * np.ones(shape) for s in sigmas], axis=-1) ** 2
    errors = np.empty((*shape, on.gyr_rad_s.shape[1]))
    for k in range(errors.shape[2]):
        if k > 0:
            turn = dt * (on.gyr_rad_s[:, k] - x[..., 3:6])
            R = R @ exponential(turn)
            P = predicted(P, turn, dt, (p[0] * dt) ** 2)
        errors[:, :, k] = 0.25 * (3.0 - np.sum(R * on.truth[:, k], axis=(-2, -1)))
        u = np.swapaxes(R, -1, -2)[..., None, :, :] @ inertial[:, :, None]
        u = u[..., 0].reshape(*shape, 6)  # both vectors as the estimate has them
        R, x, P = corrected(R, x, P, v[:, k] - u, u, p)
    return errors


def predicted(P: Array, turn: Array, dt: float, noise: Array) -> Array:
    """P <- F P F' + Q: delta' = delta - turn x delta - dt db."""
    F = np.zeros_like(P) + np.eye(P.shape[-1])
    F[..., :3, :3] -= cross_matrix(turn)
    F[..., [0, 1, 2], [3, 4, 5]] = -dt
    P = F @ P @ np.swapaxes(F, -1, -2)
    P[..., [0, 1, 2], [0, 1, 2]] += noise[..., None]
    return P


def corrected(
    R: Array, x: Array, P: Array, innovation: Array, u: Array, p: Array
) -> tuple[Array, Array, Array]:
    """Both vectors at once: v = u + u x delta, and what is wrong with them."""
    diagonal = np.arange(6)
    H = np.zeros((*P.shape[:2], 6, P.shape[-1]))
    H[..., :3, :3], H[..., 3:, :3] = cross_matrix(u[..., :3]), cross_matrix(u[..., 3:])
    H[..., diagonal, 6 + diagonal] = 1.0
    innovation = innovation - x[..., 6:]
    S = measured(H, P, p[1])
    excess = np.mean(innovation**2 / S[..., diagonal, diagonal], axis=-1)
    anew = excess > p[4]
    if anew.any():
        P[anew, :3, :], P[anew, :, :3] = 0.0, 0.0
        for i in range(3):
            P[..., i, i] = np.where(anew, p[2] ** 2, P[..., i, i])
        S = measured(H, P, p[1])
    gain = np.swapaxes(np.linalg.solve(S, H @ P), -1, -2)
    moved = (gain @ innovation[..., None])[..., 0]
    x = x + moved
    x[..., :3] = 0.0  # always moved into R
    return R @ exponential(moved[..., :3]), x, P - gain @ H @ P


def measured(H: Array, P: Array, sigma: Array) -> Array:
    """H P H' + R."""
    S = H @ P @ np.swapaxes(H, -1, -2)
    S[..., np.arange(6), np.arange(6)] += (sigma**2)[..., None]
    return np.asarray(S)
