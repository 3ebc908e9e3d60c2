"""The built-in flight against physics written out independently."""

from math import asin, atan2, degrees

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.simulation.flight import (
    FIELD_NED_GAUSS,
    LATITUDE_DEG,
    LONGITUDE_DEG,
    ROUND_S,
    SET_DOWN_S,
    SHAKE_HZ,
    SHAKE_M,
    flight_truth,
    geodetic,
)
from drivers.simulation.simulated_vehicle import simulate
from estimator.geometry.earth import distance_m, field_at
from estimator.geometry.frames import euler_rad
from estimator.geometry.quaternion import rotate_inverse

G = 9.80665
STEP_S = 0.01
TIMES = np.arange(round(2 * ROUND_S / STEP_S)) * STEP_S
TRUTH = flight_truth(TIMES)


def rotations(q):
    return Rotation.from_quat(q, scalar_first=True)


def test_the_rate_turns_the_attitude():
    turns = (rotations(TRUTH.q_ned_frd[:-1]).inv() * rotations(TRUTH.q_ned_frd[1:])).as_rotvec()
    mean = (TRUTH.rate_rad_s[1:] + TRUTH.rate_rad_s[:-1]) / 2
    # the trapezoid's error, at most 1.7e-5
    assert np.abs(turns / STEP_S - mean).max() < 1e-4


def test_the_specific_force_is_acceleration_less_gravity():
    """But for the first two seconds, when somebody holds it, velocity and force are one motion."""
    free = TIMES[1:-1] > SET_DOWN_S + STEP_S
    acceleration = (TRUTH.velocity_ned_m_s[2:] - TRUTH.velocity_ned_m_s[:-2]) / (2 * STEP_S)
    force = rotations(TRUTH.q_ned_frd).apply(TRUTH.force_frd_m_s2)[1:-1]
    difference = force - acceleration + [0, 0, G]
    assert np.abs(difference[free]).max() < 1e-2
    velocity = (TRUTH.position_ned_m[2:] - TRUTH.position_ned_m[:-2]) / (2 * STEP_S)
    assert np.abs(velocity - TRUTH.velocity_ned_m_s[1:-1]).max() < 1e-2


def test_the_rotors_push_along_body_up_and_the_air_slows():
    """The force in the body is thrust up and drag against the velocity, whatever the bank."""
    aloft = TIMES > SET_DOWN_S
    velocity = rotations(TRUTH.q_ned_frd).inv().apply(TRUTH.velocity_ned_m_s)
    sideways = TRUTH.force_frd_m_s2[aloft, :2] + 0.15 * velocity[aloft, :2]
    assert np.abs(sideways).max() < 1e-6
    assert TRUTH.force_frd_m_s2[:, 2].max() < -3.0


def test_it_is_a_flight():
    tilt = np.degrees(np.arccos(rotations(TRUTH.q_ned_frd).apply([0, 0, 1.0])[:, 2].clip(-1, 1)))
    assert tilt[TIMES < 6].max() < 1e-6  # on the ground
    assert 50 < tilt.max() < 65
    assert 15 < np.linalg.norm(TRUTH.velocity_ned_m_s, axis=1).max() < 20
    assert TRUTH.position_ned_m[:, 2].min() == pytest.approx(-20.0)
    yaw = np.unwrap([euler_rad(tuple(q))[2] for q in TRUTH.q_ned_frd[:10_000:10]])
    assert yaw[-1] - yaw[0] == pytest.approx(4 * np.pi, abs=1e-3)


def test_whoever_aligns_at_once_starts_wrong():
    first = TRUTH.force_frd_m_s2[0]
    tilt_deg = degrees(atan2(np.hypot(first[0], first[1]), -first[2]))
    assert tilt_deg == pytest.approx(degrees(atan2((2 * np.pi * SHAKE_HZ) ** 2 * SHAKE_M, G)))
    assert tilt_deg > 10


def test_the_field_is_that_of_the_place():
    place = geodetic((0.0, 0.0, 0.0))
    known = field_at(*place, 1_767_225_600_000_000)  # 2026-01-01
    north, east, down = FIELD_NED_GAUSS
    strength = float(np.linalg.norm(FIELD_NED_GAUSS))
    assert degrees(atan2(east, north) - known.declination_rad) == pytest.approx(0, abs=0.05)
    assert degrees(asin(down / strength) - known.dip_rad) == pytest.approx(0, abs=0.05)
    assert strength == pytest.approx(known.strength_gauss, rel=1e-3)


def test_places_are_as_far_away_as_they_should_be():
    north, east = geodetic((1000.0, 0.0, 0.0)), geodetic((0.0, 1000.0, -5.0))
    start = (LATITUDE_DEG, LONGITUDE_DEG)
    assert distance_m(start, north[:2]) == pytest.approx(1000, abs=1)
    assert distance_m(start, east[:2]) == pytest.approx(1000, abs=1)
    assert east[2] - geodetic((0.0, 0.0, 0.0))[2] == 5.0


def test_the_magnet_passes_once_a_round_and_a_calm_flight_has_none():
    recording = simulate(0, round(2.2 * ROUND_S * 20), rate_hz=20, motion="flight", noise=0, bias=0)
    field = rotations(recording.q_ned_frd).inv().apply(FIELD_NED_GAUSS)
    passing = np.linalg.norm(recording.mag_gauss - field, axis=1) > 0.1
    times = recording.time_us[passing] * 1e-6
    assert set((times // ROUND_S).tolist()) == {0.0, 1.0}
    assert set((times % ROUND_S // 1).tolist()) == {50.0, 51.0}


def test_a_flights_sensors_are_off_by_their_biases():
    """Without noise: rad/s, m/s^2 and gauss, each axis by another amount."""
    made = simulate(1, 200, 100.0, "flight", noise=0.0, magnet=(900.0, 901.0))
    truth = flight_truth(made.time_us * 1e-6)
    off = made.gyr_rad_s - truth.rate_rad_s
    np.testing.assert_allclose(off, np.tile((0.003, -0.004, 0.002), (200, 1)), atol=1e-9)
    off = made.acc_m_s2 - truth.force_frd_m_s2
    np.testing.assert_allclose(off, np.tile((0.03, -0.025, 0.05), (200, 1)), atol=1e-9)
    field = np.array([rotate_inverse(tuple(q), FIELD_NED_GAUSS) for q in truth.q_ned_frd])
    off = made.mag_gauss - field
    np.testing.assert_allclose(off, np.tile((0.004, -0.003, 0.005), (200, 1)), atol=1e-9)
