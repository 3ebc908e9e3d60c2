"""Iron found in made-up flights, beside the truth and beside an algebraic fit of a sphere."""

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.geometry.earth import PlaceField, in_ned
from tuning.compass_fit import fit_compass

FIELD = PlaceField(0.05, 1.1, 0.48)
NOISE_GAUSS, DOWN_NOISE_RAD = 0.004, 0.01
N = 1500


def flight(seed, tilt_rad, matrix, turns=True):
    """Readings, the vertical as an estimate would know it, and the offset put in."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 200.0, N)
    a, b = rng.uniform(0.0, 6.0, 2)
    yaw = np.cumsum(rng.normal(0.0, 0.05, N)) * turns
    sway = tilt_rad * np.column_stack([np.sin(0.3 * t + a), np.sin(0.41 * t + b)])
    to_body = Rotation.from_euler("ZYX", np.column_stack([yaw, sway])).inv()
    offset = rng.normal(0.0, 0.1, 3)
    mag = to_body.apply(in_ned(FIELD)) @ np.linalg.inv(matrix) + offset
    errors = np.zeros((N, 3))
    for k in range(1, N):  # an estimate errs slowly: 50 samples
        errors[k] = 0.98 * errors[k - 1] + rng.normal(0.0, 0.2 * DOWN_NOISE_RAD, 3)
    down = (Rotation.from_rotvec(errors) * to_body).apply([0.0, 0.0, 1.0])
    return mag + rng.normal(0.0, NOISE_GAUSS, mag.shape), down, offset


def test_offsets_lie_within_three_sigma():
    """In flat and steep flights, half with soft iron."""
    within, shown = [], []
    for seed in range(12):
        soft = np.random.default_rng(100 + seed).normal(0.0, 0.03, (3, 3)) * (seed % 2)
        matrix = np.eye(3) + (soft + soft.T) / 2.0
        mag, down, offset = flight(seed, (0.1, 0.3, 0.8)[seed % 3], matrix)
        fit = fit_compass(mag, down, FIELD)
        sigma = np.sqrt(np.diag(fit.offset_covariance))
        within += list(np.abs(fit.offset_gauss - offset) < 3.0 * sigma)
        assert sigma.max() < 0.1  # gauss; most where it is flat and has soft iron
        shown.append((fit.matrix is not None) == (seed % 2 == 1))
        if fit.matrix is not None:
            assert np.all(np.abs(fit.matrix - matrix) < 5.0 * fit.matrix_sigma)
    assert np.mean(within) >= 0.95
    assert np.mean(shown) >= 0.9  # soft iron is reported where there is some, and nowhere else


def test_a_sphere_fitted_without_the_model_agrees():
    """|m|^2 = 2 b.m + c, linear in b."""
    mag, down, _ = flight(2, 1.5, np.eye(3))
    sphere = np.linalg.lstsq(np.column_stack([2.0 * mag, np.ones(N)]), (mag**2).sum(1))[0][:3]
    assert np.abs(fit_compass(mag, down, FIELD).offset_gauss - sphere).max() < 2e-3


def test_without_turns_nothing_is_sure():
    """A fit's sigma then covers its error; five readings give no fit."""
    for seed in range(3):
        mag, down, offset = flight(seed, 0.0, np.eye(3), turns=False)
        fit = fit_compass(mag, down, FIELD)
        if fit is not None:
            error = fit.offset_gauss - offset
            assert error @ np.linalg.solve(fit.offset_covariance, error) < 16.0  # 4 sigma
            assert np.linalg.eigvalsh(fit.offset_covariance)[-1] > 0.02**2
    assert fit_compass(mag[:5], down[:5], FIELD) is None


def test_a_field_that_is_wild_for_a_while_changes_little():
    mag, down, offset = flight(5, 0.8, np.eye(3))
    mag[700:800] += 20.0
    assert np.abs(fit_compass(mag, down, FIELD).offset_gauss - offset).max() < 5e-3
