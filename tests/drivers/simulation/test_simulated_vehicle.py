"""The simulated vehicle against the paper's equations, written out independently."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from drivers.simulation.simulated_vehicle import (
    FIELD_GAUSS,
    MAGNET_PEAK_GAUSS,
    TURN_RATE_RAD_S,
    SimulatedVehicle,
    simulate,
)
from estimator.errors import InputError

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


def rotations(q):
    return Rotation.from_quat(q, scalar_first=True)


@pytest.mark.parametrize("rate_hz", [0.5, 1, 4, 30, 50, 100, 333.3, 400])
def test_truth_is_the_paper_s_attitude_at_any_rate(rate_hz):
    recording = simulate(seed=0, samples=int(15 * rate_hz) + 1, rate_hz=rate_hz)
    times = np.arange(len(recording.time_us)) / rate_hz
    error = (rotations(recording.q_ned_frd).inv() * paper_attitude(times)).magnitude()
    # rad; the integrator's tolerance over 15 s; steps of 0.1 s would leave 2e-7
    assert error.max() < 1e-7
    rates = np.array([paper_rate(t) for t in times])
    np.testing.assert_allclose(recording.true_rate_rad_s, rates, atol=1e-12)


def test_without_noise_the_readings_are_the_paper_s_vectors_plus_bias():
    recording = simulate(seed=0, samples=500, noise=0.0)
    body = rotations(recording.q_ned_frd).inv()
    v_1 = body.apply(np.array([1, -1, 1]) / np.sqrt(3)) + 0.1 * np.array([1, -1, 1])
    v_2 = body.apply([0, 0, 1]) + 0.1 * np.array([0, 0, 1])
    np.testing.assert_allclose(recording.mag_gauss, 0.5 * v_1, atol=1e-12)
    np.testing.assert_allclose(recording.acc_m_s2, -G * v_2, atol=1e-12)
    bias = recording.gyr_rad_s - recording.true_rate_rad_s
    np.testing.assert_allclose(bias, np.tile([-0.1, 0.1, 0.05], (500, 1)), atol=1e-12)


def test_noise_has_the_paper_s_standard_deviations():
    n = 50_000
    noisy, clean = simulate(7, n), simulate(7, n, noise=0.0)
    # the standard error of a deviation estimated from n numbers is 1/sqrt(2n), 0.3 %; five of them
    for noise, sigma in (
        (noisy.gyr_rad_s - clean.gyr_rad_s, 0.2),
        ((noisy.acc_m_s2 - clean.acc_m_s2) / G, 0.05),
        ((noisy.mag_gauss - clean.mag_gauss) / FIELD_GAUSS, 0.05),
    ):
        assert np.allclose(noise.std(axis=0), sigma, rtol=0.016)
        assert np.allclose(noise.mean(axis=0), 0.0, atol=5 * sigma / np.sqrt(n))
    all_noise = np.hstack(
        [noisy.gyr_rad_s - clean.gyr_rad_s, noisy.acc_m_s2 - clean.acc_m_s2,
         noisy.mag_gauss - clean.mag_gauss]
    )  # fmt: skip
    correlation = np.corrcoef(all_noise.T) - np.eye(9)
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
def test_stream_and_block_are_bit_equal(options):
    block = simulate(11, 700, **options)
    vehicle = SimulatedVehicle(11, **options)
    streamed = [next(vehicle) for _ in range(700)]
    for name, expected in block._asdict().items():
        assert np.array_equal(np.array([getattr(s, name) for s in streamed]), expected), name


def test_seeds_differ_and_repeat():
    assert np.array_equal(simulate(1, 50).acc_m_s2, simulate(1, 50).acc_m_s2)
    assert not np.array_equal(simulate(1, 50).acc_m_s2, simulate(2, 50).acc_m_s2)


def test_rest_stays_and_turn_turns():
    rest = simulate(0, 200, motion="rest", noise=0, bias=0)
    np.testing.assert_allclose(rest.q_ned_frd, np.tile([1, 0, 0, 0], (200, 1)), atol=1e-12)
    np.testing.assert_allclose(rest.acc_m_s2[-1], [0, 0, -G], atol=1e-12)
    turn = simulate(0, 301, motion="turn")
    yaw = rotations(turn.q_ned_frd).as_rotvec()[:, 2]
    np.testing.assert_allclose(yaw, TURN_RATE_RAD_S * turn.time_us * 1e-6, atol=1e-9)


def test_magnet_disturbs_only_between_its_times():
    clean, disturbed = simulate(0, 1000), simulate(0, 1000, magnet=(2.0, 4.0))
    field = disturbed.mag_gauss - clean.mag_gauss
    t = clean.time_us * 1e-6
    assert np.all(field[(t <= 2.0) | (t >= 4.0)] == 0)
    assert np.all(field[(t > 2.0) & (t < 4.0), 1] > 0)
    assert field[t == 3.0, 1] == pytest.approx(MAGNET_PEAK_GAUSS)
    assert np.all(field[:, [0, 2]] == 0)


def test_another_rate_goes_on_with_the_same_motion():
    vehicle = SimulatedVehicle(0, rate_hz=4.0)
    before = [next(vehicle) for _ in range(9)][-1]
    vehicle.change_rate(50.0)
    after = [next(vehicle) for _ in range(300)]
    assert after[0].time_us == before.time_us + 20_000
    assert {b.time_us - a.time_us for a, b in itertools.pairwise(after)} == {20_000}
    expected = simulate(0, 2 * 50 + 1 + 300, rate_hz=50.0)
    index = np.searchsorted(expected.time_us, [s.time_us for s in after])
    error = rotations([s.q_ned_frd for s in after]).inv() * rotations(expected.q_ned_frd[index])
    assert error.magnitude().max() < 1e-7


def test_arrays_are_constant():
    for name, values in simulate(0, 10)._asdict().items():
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0
        assert len(values) == 10, name


@pytest.mark.parametrize("rate_hz", [0.0, -5.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate_hz):
    with pytest.raises(InputError, match="rate must be positive"):
        simulate(0, 3, rate_hz)
