"""The attitude from velocity alone, against truth and against SciPy's solution."""

from math import degrees

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.aiding.search import EMPTY_SEARCH, add_report, add_sample, solve
from estimator.aiding.types import Report
from estimator.conditioning.params import MEMORY_S, SPAN_S
from estimator.geometry.metrics import angle_errors
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2

DT = 0.02
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
BIAS_SIGMA_RAD_S = 0.001
DOWN = (0.0, 0.0, 1.0)


def report(velocity, ago_s=0.0, late_sigma_s=0.0):
    return Report(True, tuple(velocity.tolist()), True, 0.3, ago_s, late_sigma_s)


def searched(rng, *, seconds=20.0, push_m_s2=2.0, noise_m_s=0.05):
    """A search fed with random pushes, the true attitude of G, and the windows' vectors."""
    truth = Rotation.random(random_state=int(rng.integers(1 << 30)))
    search, velocity, push = EMPTY_SEARCH, np.zeros(3), np.zeros(3)
    starts, windows = np.zeros(3), []
    force = np.zeros(3)
    for k in range(round(seconds / DT)):
        if k % 75 == 0:
            push = push_m_s2 * rng.standard_normal(3)
        velocity = velocity + push * DT
        acc = truth.inv().apply(push - GRAVITY)
        search = add_sample(search, (1.0, 0.0, 0.0, 0.0), tuple(acc.tolist()), DT, 0.0)
        force = force + acc * DT
        reported = velocity + noise_m_s * rng.standard_normal(3)
        before = search
        search, closed = add_report(search, report(reported), IDENTITY, DOWN)
        if closed:
            window = before.window
            windows.append((reported - starts - GRAVITY * window.time_s, window.pushed_m_s))
        if closed or not before.window.is_open:
            starts = reported
    return search, truth, windows


def errors_deg(answer, q_ned_g):
    """Total, heading's and inclination's."""
    w, x, y, z = q_ned_g.as_quat(scalar_first=True)
    return np.degrees(angle_errors(answer.q_ned_g, (w, x, y, z)))


@pytest.mark.parametrize(
    ("seed", "measured_deg"), list(enumerate((0.655, 0.048, 0.145, 0.237, 0.122, 0.388)))
)
def test_it_finds_the_attitude(seed, measured_deg):
    search, truth, _ = searched(np.random.default_rng(seed))
    answer = solve(search, BIAS_SIGMA_RAD_S)
    errors = errors_deg(answer, truth)
    assert np.max(errors) == pytest.approx(measured_deg, rel=0.2)
    assert errors[1] < degrees(answer.sigma_heading_rad)
    assert degrees(answer.sigma_heading_rad) == pytest.approx(1.06, rel=0.22)  # 0.86 to 1.24


@pytest.mark.parametrize("seed", range(3))
def test_it_is_scipys_solution_of_the_same_windows(seed):
    """``Rotation.align_vectors`` with the weights that forgetting leaves."""
    search, _, windows = searched(np.random.default_rng(seed), seconds=8.0)
    a, b = (np.array(side) for side in zip(*windows, strict=True))
    weights = np.exp(-np.arange(len(a))[::-1] * SPAN_S / MEMORY_S)
    wanted, _ = Rotation.align_vectors(a, b, weights=weights)
    assert errors_deg(solve(search, BIAS_SIGMA_RAD_S), wanted)[0] < 1e-9  # measured 1e-13


def test_a_vehicle_at_rest_shows_no_heading():
    search, _, _ = searched(np.random.default_rng(1), push_m_s2=0.0)
    assert search.evidence.windows == pytest.approx(14.3, rel=0.2)
    assert solve(search, BIAS_SIGMA_RAD_S) is None


def test_noise_is_no_motion():
    search, _, _ = searched(np.random.default_rng(2), push_m_s2=0.0, noise_m_s=1.0, seconds=60.0)
    assert solve(search, BIAS_SIGMA_RAD_S) is None


def test_two_windows_are_enough_and_one_is_not():
    search, _, _ = searched(np.random.default_rng(3), seconds=1.5)
    assert solve(search, BIAS_SIGMA_RAD_S) is None
    search, truth, _ = searched(np.random.default_rng(3), seconds=2.5)
    answer = solve(search, BIAS_SIGMA_RAD_S)
    assert errors_deg(answer, truth)[1] < 2.0 * degrees(answer.sigma_heading_rad)
    assert degrees(answer.sigma_heading_rad) == pytest.approx(3.77, rel=0.2)


@pytest.mark.parametrize(
    ("aliasing", "off_deg", "sigma_deg"), [(4.0, 5.26, 11.8), (0.0, 40.0, 16.2)]
)
def test_what_was_seen_before_a_missed_turn_counts_less(aliasing, off_deg, sigma_deg):
    search, velocity, g = EMPTY_SEARCH, np.zeros(3), Rotation.identity()
    turns = round(20.0 / DT)
    for k in range(round(28.0 / DT)):
        if k == turns:
            g = Rotation.from_rotvec([0.6, 0.0, 0.8])
        push = 4.0 * np.array((np.sin(2.5 * k * DT), np.cos(1.7 * k * DT), 0.0))
        velocity = velocity + push * DT
        acc = tuple(g.inv().apply(push - GRAVITY).tolist())
        search = add_sample(search, IDENTITY, acc, DT, aliasing if k == turns else 0.0)
        search, _ = add_report(search, report(velocity), IDENTITY, DOWN)
    answer = solve(search, BIAS_SIGMA_RAD_S)
    assert errors_deg(answer, g)[0] == pytest.approx(off_deg, rel=0.2)
    assert degrees(answer.sigma_heading_rad) == pytest.approx(sigma_deg, rel=0.2)


def moved(
    push_at, *, seconds, rate_hz=50.0, ago_s=0.0, late_s=0.0, late_sigma_s=0.0, drift_rad_s=0.0
):
    """What a search finds that is fed without noise, and the error of its heading, deg.

    ``push_at(t)`` is the acceleration in NED; five reports a second each have the velocity of
    ``ago_s + late_s`` before, stamped ``ago_s``. The frame G turns by ``drift_rad_s``.
    """
    fine_s = 1e-3
    truth = Rotation.from_euler("ZYX", [2.0, 0.3, -0.5])
    times = np.arange(round(seconds / fine_s)) * fine_s
    pushes = np.array([push_at(t) for t in times])
    velocities = np.cumsum(pushes, axis=0) * fine_s
    every, spacing = round(1.0 / (rate_hz * fine_s)), 200
    older = round((ago_s + late_s) / fine_s)
    search, heading_rad = EMPTY_SEARCH, 0.0
    for k in range(every, len(times), every):
        heading_rad = drift_rad_s * times[k]
        g_frd = truth.inv() * Rotation.from_rotvec([0.0, 0.0, heading_rad]) * truth
        x, y, z, w = g_frd.as_quat()
        acc = tuple(truth.inv().apply(pushes[k] - GRAVITY).tolist())
        search = add_sample(search, (w, x, y, z), acc, every * fine_s, 0.0)
        if k % max(spacing, every) == 0 and k > older:
            reported = report(velocities[k - older], ago_s, late_sigma_s)
            search, _ = add_report(search, reported, IDENTITY, DOWN)
    answer = solve(search, max(drift_rad_s, BIAS_SIGMA_RAD_S))
    if answer is None:
        return None, 0.0
    g = truth * Rotation.from_rotvec(truth.inv().apply([0, 0, -heading_rad]))
    return answer, float(errors_deg(answer, g)[1])


def circle(t):
    """6 m/s^2 of centripetal acceleration, one turn in 6.3 s."""
    return (6.0 * np.cos(t), 6.0 * np.sin(t), 0.0)


def test_a_steady_push_looks_like_gravity():
    """A take-off run: every window is the same vector, about which anything may have turned."""
    answer, _ = moved(lambda _: (3.0, 0.0, 0.0), seconds=20.0)
    assert answer is None
    answer, error = moved(lambda t: (3.0 if t > 5.0 else 0.0, 0.0, 0.0), seconds=20.0)
    assert error < 1e-9  # after some rest it is; measured 1e-13


@pytest.mark.parametrize(
    ("circling", "error_deg", "sigma_deg"),
    [
        ({"seconds": 10.0, "ago_s": 0.2}, 0.12, None),  # a radian a second: 11 deg without its age
        # reports of uncertain age: a delay looks like a turn
        ({"seconds": 10.0, "late_s": 0.0, "late_sigma_s": 0.1}, 5.74, 5.71),
        ({"seconds": 10.0, "late_s": 0.1, "late_sigma_s": 0.1}, 0.01, 5.71),
        ({"seconds": 10.0, "late_s": 0.25, "late_sigma_s": 0.1}, 8.58, 5.71),
        # slow samples: the first step of a window counts as much as the others
        ({"seconds": 20.0, "rate_hz": 4.0}, 0.0287, None),
        ({"seconds": 15.0, "drift_rad_s": 0.01}, 4.19, 3.86),  # what the gyroscope has drifted
    ],
)
def test_the_heading_in_a_circle(circling, error_deg, sigma_deg):
    answer, error = moved(circle, **circling)
    assert error == pytest.approx(error_deg, rel=0.2)
    if sigma_deg is not None:
        assert degrees(answer.sigma_heading_rad) == pytest.approx(sigma_deg, rel=0.2)
