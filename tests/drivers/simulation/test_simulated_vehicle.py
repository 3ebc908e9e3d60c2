"""The simulated vehicle against the paper's equations, and its flight against physics."""

import itertools
from math import asin, atan2, degrees, inf, nan

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from drivers.simulation import flight
from drivers.simulation import simulated_vehicle as vehicles
from estimator.errors import InputError
from estimator.geometry.earth import distance_m, field_at
from estimator.geometry.frames import euler_rad
from tests.vocabulary import scipy_rotation as rotations

G = 9.80665


def paper_rate(t):
    return np.array(
        [np.sin(0.4 * t), np.sin(0.7 * t + np.pi / 4), 0.4 * np.sin(0.3 * t + np.pi / 2)]
    )


def paper_attitude(times):
    """R(t) of the paper by a general integrator, as rotations."""

    def derivative(t, flat):
        x, y, z = paper_rate(t)
        omega = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return (flat.reshape(3, 3) @ omega).ravel()

    solution = solve_ivp(
        derivative, (0, times[-1]), np.eye(3).ravel(), t_eval=times, rtol=1e-10, atol=1e-11
    )
    return Rotation.from_matrix(solution.y.T.reshape(-1, 3, 3))


@pytest.mark.parametrize("rate_hz", [0.5, 1, 4, 30, 50, 100, 333.3, 400])
def test_truth_is_the_paper_s_attitude_at_any_rate(rate_hz):
    recording = vehicles.simulate(seed=0, samples=int(15 * rate_hz) + 1, rate_hz=rate_hz)
    times = np.arange(len(recording.time_us)) / rate_hz
    error = (rotations(recording.q_ned_frd).inv() * paper_attitude(times)).magnitude()
    # rad; the integrator's tolerance over 15 s; steps of 0.1 s would leave 2e-7
    assert error.max() < 1e-7
    rates = np.array([paper_rate(t) for t in times])
    np.testing.assert_allclose(recording.true_rate_rad_s, rates, atol=1e-12)


def test_without_noise_the_readings_are_the_paper_s_vectors_plus_bias():
    recording = vehicles.simulate(seed=0, samples=500, noise=0.0)
    body = rotations(recording.q_ned_frd).inv()
    v_1 = body.apply(np.array([1, -1, 1]) / np.sqrt(3)) + 0.1 * np.array([1, -1, 1])
    v_2 = body.apply([0, 0, 1]) + 0.1 * np.array([0, 0, 1])
    np.testing.assert_allclose(recording.mag_gauss, 0.5 * v_1, atol=1e-12)
    np.testing.assert_allclose(recording.acc_m_s2, -G * v_2, atol=1e-12)
    bias = recording.gyr_rad_s - recording.true_rate_rad_s
    np.testing.assert_allclose(bias, np.tile([-0.1, 0.1, 0.05], (500, 1)), atol=1e-12)


def test_noise_has_the_paper_s_standard_deviations():
    n = 50_000
    noisy, clean, every = vehicles.simulate(7, n), vehicles.simulate(7, n, noise=0.0), []
    # the standard error of a deviation estimated from n numbers is 1/sqrt(2n), 0.3 %; five of them
    for noise, sigma in (
        (noisy.gyr_rad_s - clean.gyr_rad_s, 0.2),
        ((noisy.acc_m_s2 - clean.acc_m_s2) / G, 0.05),
        ((noisy.mag_gauss - clean.mag_gauss) / vehicles.FIELD_GAUSS, 0.05),
    ):
        assert np.allclose(noise.std(axis=0), sigma, rtol=0.016)
        assert np.allclose(noise.mean(axis=0), 0.0, atol=5 * sigma / np.sqrt(n))
        every.append(noise)
    correlation = np.corrcoef(np.hstack(every).T) - np.eye(9)
    assert np.abs(correlation).max() < 5 / np.sqrt(n)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rate_hz": 7.0},
        {"motion": "turn", "magnet": (0.5, 1.5)},
        {"noise": 0.3, "bias": 2.0, "rate_hz": 400.0},
        {"motion": "flight", "rate_hz": 5.0},
    ],
)
def test_stream_and_block_of_a_seed_are_bit_equal_and_others_differ(options):
    block = vehicles.simulate(11, 700, **options)
    vehicle = vehicles.SimulatedVehicle(11, **options)
    streamed = [next(vehicle) for _ in range(700)]
    for name, expected in block._asdict().items():
        assert np.array_equal(np.array([getattr(s, name) for s in streamed]), expected), name
    assert not np.array_equal(block.acc_m_s2, vehicles.simulate(12, 700, **options).acc_m_s2)


def test_rest_stays_and_turn_turns():
    rest = vehicles.simulate(0, 200, motion="rest", noise=0, bias=0)
    np.testing.assert_allclose(rest.q_ned_frd, np.tile([1, 0, 0, 0], (200, 1)), atol=1e-12)
    np.testing.assert_allclose(rest.acc_m_s2[-1], [0, 0, -G], atol=1e-12)
    turn = vehicles.simulate(0, 301, motion="turn")
    yaw = rotations(turn.q_ned_frd).as_rotvec()[:, 2]
    np.testing.assert_allclose(yaw, vehicles.TURN_RATE_RAD_S * turn.time_us * 1e-6, atol=1e-9)


def test_magnet_disturbs_only_between_its_times():
    clean, disturbed = vehicles.simulate(0, 1000), vehicles.simulate(0, 1000, magnet=(2.0, 4.0))
    field = disturbed.mag_gauss - clean.mag_gauss
    t = clean.time_us * 1e-6
    assert np.all(field[(t <= 2.0) | (t >= 4.0)] == 0)
    assert np.all(field[(t > 2.0) & (t < 4.0), 1] > 0)
    assert field[t == 3.0, 1] == pytest.approx(vehicles.MAGNET_PEAK_GAUSS)
    assert np.all(field[:, [0, 2]] == 0)


def test_another_rate_goes_on_with_the_same_motion():
    vehicle = vehicles.SimulatedVehicle(0, rate_hz=4.0)
    before = [next(vehicle) for _ in range(9)][-1]
    vehicle.change_rate(50.0)
    after = [next(vehicle) for _ in range(300)]
    assert after[0].time_us == before.time_us + 20_000
    assert {b.time_us - a.time_us for a, b in itertools.pairwise(after)} == {20_000}
    expected = vehicles.simulate(0, 2 * 50 + 1 + 300, rate_hz=50.0)
    index = np.searchsorted(expected.time_us, [s.time_us for s in after])
    error = rotations([s.q_ned_frd for s in after]).inv() * rotations(expected.q_ned_frd[index])
    assert error.magnitude().max() < 1e-7


def test_arrays_are_constant():
    for name, values in vehicles.simulate(0, 10)._asdict().items():
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0
        assert len(values) == 10, name


@pytest.mark.parametrize(
    ("samples", "rate_hz", "words"),
    [(0, 50.0, "1 sample"), *((3, hz, "rate must be positive") for hz in (0.0, -5.0, nan, inf))],
)
def test_no_samples_and_a_rate_that_is_none_are_refused(samples, rate_hz, words):
    with pytest.raises(InputError, match=words):
        vehicles.simulate(0, samples, rate_hz)


STEP_S = 0.01
TIMES = np.arange(round(2 * flight.ROUND_S / STEP_S)) * STEP_S
TRUTH = flight.flight_truth(TIMES)


def test_the_rate_turns_the_attitude():
    turns = (rotations(TRUTH.q_ned_frd[:-1]).inv() * rotations(TRUTH.q_ned_frd[1:])).as_rotvec()
    mean = (TRUTH.rate_rad_s[1:] + TRUTH.rate_rad_s[:-1]) / 2
    # the trapezoid's error, at most 1.7e-5
    assert np.abs(turns / STEP_S - mean).max() < 1e-4


def test_the_specific_force_is_acceleration_less_gravity():
    """But for the first two seconds, when somebody holds it, velocity and force are one motion."""
    free = TIMES[1:-1] > flight.SET_DOWN_S + STEP_S
    acceleration = (TRUTH.velocity_ned_m_s[2:] - TRUTH.velocity_ned_m_s[:-2]) / (2 * STEP_S)
    force = rotations(TRUTH.q_ned_frd).apply(TRUTH.force_frd_m_s2)[1:-1]
    difference = force - acceleration + [0, 0, G]
    assert np.abs(difference[free]).max() < 1e-2
    velocity = (TRUTH.position_ned_m[2:] - TRUTH.position_ned_m[:-2]) / (2 * STEP_S)
    assert np.abs(velocity - TRUTH.velocity_ned_m_s[1:-1]).max() < 1e-2


def test_the_rotors_push_along_body_up_and_the_air_slows():
    """The force in the body is thrust up and drag against the velocity, whatever the bank."""
    aloft = TIMES > flight.SET_DOWN_S
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


def test_the_field_is_that_of_the_place():
    place = flight.geodetic((0.0, 0.0, 0.0))
    known = field_at(*place, 1_767_225_600_000_000)  # 2026-01-01
    north, east, down = flight.FIELD_NED_GAUSS
    strength = float(np.linalg.norm(flight.FIELD_NED_GAUSS))
    assert degrees(atan2(east, north) - known.declination_rad) == pytest.approx(0, abs=0.05)
    assert degrees(asin(down / strength) - known.dip_rad) == pytest.approx(0, abs=0.05)
    assert strength == pytest.approx(known.strength_gauss, rel=1e-3)


def test_places_are_as_far_away_as_they_should_be():
    north, east = flight.geodetic((1000.0, 0.0, 0.0)), flight.geodetic((0.0, 1000.0, -5.0))
    start = (flight.LATITUDE_DEG, flight.LONGITUDE_DEG)
    assert distance_m(start, north[:2]) == pytest.approx(1000, abs=1)
    assert distance_m(start, east[:2]) == pytest.approx(1000, abs=1)
    assert east[2] - flight.geodetic((0.0, 0.0, 0.0))[2] == 5.0


def test_the_magnet_passes_once_a_round_and_a_calm_flight_has_none():
    recording = vehicles.simulate(
        0, round(2.2 * flight.ROUND_S * 20), rate_hz=20, motion="flight", noise=0, bias=0
    )
    field = rotations(recording.q_ned_frd).inv().apply(flight.FIELD_NED_GAUSS)
    passing = np.linalg.norm(recording.mag_gauss - field, axis=1) > 0.1
    times = recording.time_us[passing] * 1e-6
    assert set((times // flight.ROUND_S).tolist()) == {0.0, 1.0}
    assert set((times % flight.ROUND_S // 1).tolist()) == {50.0, 51.0}


def test_a_flights_sensors_are_off_by_their_biases():
    made = vehicles.simulate(1, 200, 100.0, "flight", noise=0.0, magnet=(900.0, 901.0))
    truth = flight.flight_truth(made.time_us * 1e-6)
    field = rotations(truth.q_ned_frd).inv().apply(flight.FIELD_NED_GAUSS)
    for read, true, bias in (
        (made.gyr_rad_s, truth.rate_rad_s, (0.003, -0.004, 0.002)),
        (made.acc_m_s2, truth.force_frd_m_s2, (0.03, -0.025, 0.05)),
        (made.mag_gauss, field, (0.004, -0.003, 0.005)),
    ):
        np.testing.assert_allclose(read - true, np.tile(bias, (200, 1)), atol=1e-9)
