"""The sigma of a vehicle's vertical that nothing but its own force shows."""

from math import cos, radians, sin, tan

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.profile import load_profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from fuzzbee import Estimator

IN_VEHICLE = merge_profile(load_profile("imu"), {"conditioning": {"in_vehicle": True}})
RATE_HZ, MINUTES, STEADY_S = 25.0, 15, 120.0
SPEED_M_S, SPEED_S, JERK_S = 6.0, 8.0, 0.5


def driving(seed, drift_deg_s2):
    """Gyroscope and accelerometer (N, 3) of a level vehicle that speeds up and brakes at random."""
    rng = np.random.default_rng(seed)
    n, dt = round(60 * MINUTES * RATE_HZ), 1.0 / RATE_HZ
    velocity, acc = np.zeros(2), np.zeros((n, 3))
    push = np.zeros(2)
    for row in acc:
        drive = rng.normal(0.0, SPEED_M_S * np.sqrt(2.0 / (SPEED_S * dt)), 2) - velocity / SPEED_S
        push += dt / JERK_S * (drive - push)
        velocity += dt * push
        row[:2] = push
    acc[:, 2] = -STANDARD_GRAVITY_M_S2
    axis = rng.normal(size=3)
    bias = np.radians(drift_deg_s2) * dt * np.arange(n)[:, None] * axis / np.linalg.norm(axis)
    return bias + rng.normal(0.0, 0.004, (n, 3)), acc + rng.normal(0.0, 0.2, (n, 3))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("drift_deg_s2", [0.0, 0.0015, 0.005])
def test_sigma_is_as_wide_as_the_error(seed, drift_deg_s2):
    found = Estimator(IN_VEHICLE, RATE_HZ).update_batch(*driving(seed, drift_deg_s2))
    error = 2.0 * np.arcsin(np.hypot(found.q_ned_frd[:, 1], found.q_ned_frd[:, 2]))
    sigma = found.sigma_inclination_rad
    steady = np.arange(len(error)) > STEADY_S * RATE_HZ
    assert 0.35 < np.mean((error < sigma)[steady]) < 0.97
    assert np.mean((error > 3.0 * sigma)[steady]) < 0.02


@pytest.mark.parametrize("bank_deg", [30.0, 60.0])
def test_a_vehicle_that_begins_in_a_bank_is_unsure_of_it(bank_deg):
    bank, n = radians(bank_deg), round(20.0 * RATE_HZ)
    turn_rad_s = STANDARD_GRAVITY_M_S2 * tan(bank) / 25.0
    rng = np.random.default_rng(3)
    gyr = turn_rad_s * np.array([0.0, sin(bank), cos(bank)]) + rng.normal(0.0, 0.004, (n, 3))
    acc = np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2 / cos(bank)]) + rng.normal(0.0, 0.2, (n, 3))
    found = Estimator(IN_VEHICLE, RATE_HZ).update_batch(gyr, acc)
    azimuth = turn_rad_s * np.arange(1, n + 1) / RATE_HZ
    truth = Rotation.from_euler("ZX", np.stack([azimuth, np.full(n, bank)], axis=1))
    known = np.isfinite(found.sigma_inclination_rad)
    down = found.to_rotation().apply([0.0, 0.0, 1.0], inverse=True)
    error = np.arccos(np.sum(down * truth[known].apply([0.0, 0.0, 1.0], inverse=True), axis=1))
    sigma = found.sigma_inclination_rad[known]
    assert error[0] > 0.8 * bank
    assert (error < 3.0 * sigma).all()
