"""Accelerations that last: what betrays them, what the vertical and its sigma make of them."""

from math import cos, pi, radians, sin, tan

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.conditioning.vertical.slow_acceleration import (
    SlowAcceleration,
    slow_variance,
    watch_rest,
    watch_slow,
)
from estimator.geometry.metrics import rms
from estimator.profile import load_profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from fuzzbee import Estimator
from tests.flight import FIELD_NED_GAUSS, TRUE_NORTH
from tests.truth.motions import step
from tests.truth.run import Case, judge

G = STANDARD_GRAVITY_M_S2


def test_shaking_is_no_acceleration_that_lasts():
    """Both make the mean square of the force the same: 1.25 times that of gravity."""
    rng = np.random.default_rng(1)
    shaken, braking, down = SlowAcceleration(), SlowAcceleration(), (0.0, 0.0, G)
    for _ in range(1000):
        x, y, z = G * (np.array((0.0, 0.0, 1.0)) + (0.25 / 3.0) ** 0.5 * rng.standard_normal(3))
        shaken = watch_slow(shaken, (x, y, z), down, down, 0.03, 0.0, 0.0, 0.25)
        braking = watch_slow(braking, (0.5 * G, 0.0, G), down, down, 0.03, 0.0, 0.0, 0.25)
    assert braking.excess == pytest.approx(0.25, rel=0.01)
    assert shaken.excess == pytest.approx(0.0, abs=0.05)


def test_a_force_that_has_turned_over_counts_as_one_that_is_off_by_a_radian():
    up, down = (0.0, 0.0, -G), (0.0, 0.0, G)
    state = SlowAcceleration(long=down)
    for _ in range(2000):
        state = watch_slow(state, up, up, down, 0.0, 0.0, 0.0, 0.25)
    assert state.apart == pytest.approx(1.0, rel=0.01)


def test_a_long_step_is_one_reading_of_a_vehicles_first_seconds():
    state, down, braking = SlowAcceleration(), (0.0, 0.0, G), (0.5 * G, 0.0, G)
    for _ in range(100):
        state = watch_slow(state, braking, down, down, 0.03, 0.0, 1.0, 0.02)
    assert state.apart >= 0.9 * 0.25
    state = watch_slow(state, down, down, down, 0.03, 0.0, 0.0, 0.2)
    assert state.excess == pytest.approx(0.25, rel=0.02)
    state = watch_slow(state, braking, down, down, 0.03, 0.0, 1.0, 0.02)
    assert state.excess == pytest.approx(0.25, rel=0.02)
    assert state.apart >= 0.98 * 0.25 * (1.0 - 2.22 / 20.0)


def test_a_rest_shows_which_force_is_gravity():
    """The sensor reads 1 % too little, so that a fifth of gravity across seems to be a tenth."""
    drifting, down = SlowAcceleration(apart=1.0, drift=1.0), (0.0, 0.0, G)
    rested = watch_rest(drifting, (0.0, 0.0, 0.99 * G), 0.25)
    for begun, variance in ((rested, 0.2**2 - 0.01), (drifting, 0.0)):
        state = begun
        for _ in range(1000):
            force = (0.99 * 0.2 * G, 0.0, 0.99 * G)
            state = watch_slow(state, force, (G, 0.0, G), down, 0.0, 1.0, 0.0, 0.25)
        assert slow_variance(state) == pytest.approx(variance, abs=1e-3)


def verdict(motion, rate_hz):
    return judge(Case(motion, has_velocity=False, rate_hz=rate_hz))


@pytest.mark.parametrize(
    ("motion", "rate_hz", "rms_deg"),
    [
        ("slalom 20", 50.0, 1.06),  # 9 by averaging
        ("accelerate and brake", 50.0, 1.26),  # 10
        ("climb and turn", 50.0, 1.09),  # 28
        ("slalom 20", 4.0, 3.32),
        ("climb and turn", 4.0, 2.14),
        ("aerobatics", 4.0, 5.6),
        ("aerobatics", 2.0, 4.8),
    ],
)
def test_a_vehicle_without_velocity_that_accelerates_for_seconds(motion, rate_hz, rms_deg):
    found = verdict(motion, rate_hz).inclination
    assert found.rms_deg == pytest.approx(rms_deg, rel=0.2)
    assert found.under_sigma >= 0.83
    assert found.beyond_three <= 0.02


@pytest.mark.parametrize(
    ("motion", "rate_hz", "has_velocity", "inclination_deg", "heading_deg"),
    [  # root mean square of the errors, and median sigma
        ("hand", 4.0, False, (2.1, 7.2), (2.1, 45.0)),
        ("hand", 2.0, False, (7.5, 14.1), (5.1, 45.0)),
        ("hand", 1.0, False, (11.2, 10.6), (10.9, 45.0)),
        ("vigorous tilts", 2.0, False, (5.8, 14.0), (4.2, 45.0)),
        ("hand", 2.0, True, (4.2, 23.8), (7.1, 49.3)),
        ("circle", 2.0, True, (3.4, 17.4), (2.6, 5.8)),
        ("aerobatics", 2.0, True, (1.53, 2.9), (2.1, 2.7)),
    ],
)
def test_a_slow_stream_hides_turns(motion, rate_hz, has_velocity, inclination_deg, heading_deg):
    found = judge(Case(motion, has_velocity=has_velocity, rate_hz=rate_hz))
    for angle, measured_deg in ((found.inclination, inclination_deg), (found.heading, heading_deg)):
        assert (angle.rms_deg, angle.sigma_deg) == pytest.approx(measured_deg, rel=0.2)


def test_a_start_in_motion_knows_that_the_force_may_be_an_acceleration():
    found = verdict("started moving", 50.0).inclination
    assert found.rms_deg == pytest.approx(4.7, rel=0.2)
    assert found.under_sigma == pytest.approx(0.70, rel=0.2)  # 0.4 without a prior
    assert found.beyond_three <= 0.01


def test_a_gyroscope_that_seems_to_turn_by_aliasing_is_no_reason_to_follow_it():
    """A car's rattle of 2 Hz, seen at 2 Hz, looks like a turn of 1 deg/s that goes on."""
    found = verdict("slalom 20", 2.0).inclination
    assert found.rms_deg == pytest.approx(19.0, rel=0.2)  # 30 without inflation of the vertical
    assert found.beyond_three <= 0.1


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


def calm_flight(rate_hz):
    """Readings and truth of a copter that rests for 20 s, then tilts slowly and holds its height.

    Its thrust is along body up, so that gravity seems to stand still in the body.
    """
    rng = np.random.default_rng(1)
    t = np.arange(150.0 * rate_hz + 1.0) / rate_hz
    waves = zip(rng.uniform(5.0, 25.0, 12), rng.uniform(0.0, 2.0 * pi, 12), strict=True)
    tilts = radians(4.0) * np.array([np.sin(2.0 * pi * t / each + phase) for each, phase in waves])
    aloft = np.clip((t - 20.0) / 4.0, 0.0, 1.0)
    angles = [0.3 * np.sin(t / 6.0), tilts[:6].sum(axis=0), tilts[6:].sum(axis=0)]
    truth = Rotation.from_euler("ZYX", aloft[:, None] * np.stack(angles, axis=1))
    gyr = rate_hz * (truth[:-1].inv() * truth[1:]).as_rotvec()
    thrust = -STANDARD_GRAVITY_M_S2 / truth[1:].as_matrix()[:, 2, 2]
    acc = thrust[:, None] * (0.0, 0.0, 1.0)
    return (
        gyr + rng.normal(0.0, 0.001, gyr.shape),
        acc + rng.normal(0.0, 0.03, acc.shape),
        truth[1:],
    )


@pytest.mark.parametrize("rate_hz", [50.0, 4.0])
def test_a_calm_flight_is_no_rest(rate_hz):
    gyr, acc, truth = calm_flight(rate_hz)
    found = Estimator(IN_VEHICLE, rate_hz).update_batch(gyr, acc)
    aloft = np.arange(len(gyr)) > 40.0 * rate_hz
    down, seen = (each.inv().as_matrix()[:, :, 2] for each in (truth, found.to_rotation()))
    error = np.arccos(np.minimum(np.sum(down * seen, axis=1), 1.0))[aloft]
    assert np.degrees(rms(error)) < 2.0  # 15 with rests in flight; 9.8 if level were assumed
    assert np.mean(error < found.sigma_inclination_rad[aloft]) > 0.8
    assert np.degrees(np.abs(found.gyro_bias_rad_s).max()) < 0.3


@pytest.mark.parametrize("rate_hz", [50.0, 4.0])
@pytest.mark.parametrize(("push_m_s2", "radius_m", "until_s"), [(0.7, 600, 60), (1.0, 900, 50)])
def test_an_even_curve_of_a_train_is_no_rest(push_m_s2, radius_m, until_s, rate_hz):
    """Nobody says that it is a vehicle; the gyroscope's bias, and so the compass, stay right."""
    rng, t = np.random.default_rng(1), np.arange(150.0 * rate_hz + 1.0) / rate_hz
    push = push_m_s2 * step((t - 20.0) / 4.0) * (1.0 - step((t - until_s) / 6.0))
    speed = np.cumsum(push) / rate_hz
    turning = speed / radius_m * step((t - until_s + 6.0) / 12.0)
    yaw, cant = np.cumsum(turning) / rate_hz, 0.5 * speed * turning / G
    velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1)
    truth = Rotation.from_euler("ZYX", np.stack([yaw, 0.0 * t, cant], axis=1))
    gyr = rate_hz * (truth[:-1].inv() * truth[1:]).as_rotvec() + (0.004, -0.002, 0.003)
    force, there = rate_hz * np.diff(velocity, axis=0) - (0.0, 0.0, G), truth[1:].inv()
    readings = np.stack([gyr, there.apply(force), there.apply(FIELD_NED_GAUSS)])
    readings += np.reshape((0.003, 0.05, 0.001), (3, 1, 1)) * rng.standard_normal(readings.shape)
    reports = np.full_like(gyr, np.nan)
    reports[:: round(rate_hz / 4.0)] = velocity[1 :: round(rate_hz / 4.0)]
    estimator = Estimator(merge_profile(load_profile("imu"), TRUE_NORTH), rate_hz)
    found = estimator.update_batch(*readings, velocity_ned_m_s=reports)
    errors = np.degrees((found.to_rotation() * there).as_rotvec())
    assert np.abs(errors[round(40.0 * rate_hz) :]).max() < 4.0  # 46 to 77 with rests there
