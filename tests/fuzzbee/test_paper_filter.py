"""The paper's filter for programs: the product's own on two vectors, and on any number."""

import copy
import pickle

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import GRAVITY_NED, MAGNETIC_NED, simulate
from estimator.filter import kernel, reference
from estimator.filter.memberships import midpoint
from estimator.filter.types import FilterState, Vectors
from estimator.geometry.rotations import unit
from fuzzbee import Estimator, InputError, PaperFilter, load_profile
from fuzzbee.attitudes import Attitudes

DT, STILL = 0.01, (0.0, 0.0, 0.0)
REFUSED = r"^gain .*: must be a number, 0\.01 to 10000$"
INERTIAL = np.array([MAGNETIC_NED, GRAVITY_NED])


def signals(samples, seed=0):
    made = simulate(seed, samples)
    return made.gyr_rad_s, np.stack([made.mag_gauss, -made.acc_m_s2], axis=1), made.q_ned_frd


@pytest.mark.parametrize("gain", [None, 30.0, "noise"])
def test_on_two_vectors_it_is_the_compiled_filter(gain):
    gyr, vectors, _ = signals(300)
    ours = PaperFilter(INERTIAL, gain=gain)
    params = ours.params
    if gain == "noise":
        params = params._replace(gain_knows_noise=True)
    elif gain is not None:
        params = params._replace(gain_is_fixed=True, fixed_gain=gain)
    state = FilterState()
    for rate, pair in zip(gyr, unit(vectors), strict=True):
        (v1, v2), (u1, u2) = (map(tuple, rows.tolist()) for rows in (pair, INERTIAL))
        state = kernel.propagate(state, tuple(rate.tolist()), DT)
        state = kernel.correct(params, state, Vectors(v1, u1, 1.0, v2, u2, 1.0, 1.0), DT)
        ours.step(rate, pair, DT)
    assert ours.R_hat == pytest.approx(reference.rotation_matrix(state.q_ned_frd), abs=1e-9)
    assert ours.b_hat == pytest.approx(state.gyr_bias_rad_s, abs=1e-9)
    wanted = (state.error, state.error_rate_1_s, state.gain)
    assert (ours.e, ours.e_rate, ours.K) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    "way", [PaperFilter.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))]
)
@pytest.mark.parametrize("gain", [None, "noise"])
def test_a_copy_goes_on_as_the_first_does_and_leaves_it_alone(way, gain):
    gyr, vectors, _ = signals(60)

    def flown(by):
        return [by.step(rate, pair, DT) for rate, pair in zip(gyr, vectors, strict=True)]

    first = PaperFilter(INERTIAL, R_hat=np.diag((1.0, -1.0, -1.0)), gain=gain)
    begun = flown(first)
    second = way(first)
    there = flown(second)
    assert np.array_equal(first.R_hat, begun[-1])
    assert np.array_equal(there, flown(first))
    second.reset()
    assert np.array_equal(begun, flown(second))


def test_more_vectors_are_better_at_the_same_weight():
    generator, rms_deg = np.random.default_rng(3), []
    eight = unit(generator.normal(size=(8, 3)))
    for v_I in (eight[:2], eight):
        filtered = PaperFilter(v_I, np.full(len(v_I), 2.0 / len(v_I)), gain=20.0)
        errors = []
        for _ in range(400):
            filtered.step(STILL, v_I + generator.normal(0.0, 0.05, v_I.shape), DT)
            errors.append(np.arccos(min(1.0, (np.trace(filtered.R_hat) - 1.0) / 2.0)))
        rms_deg.append(np.degrees(np.sqrt(np.mean(np.square(errors)))))
    assert rms_deg[0] == pytest.approx(1.5, rel=0.2)
    assert rms_deg[1] < 0.6 * rms_deg[0]


def test_the_gain_may_be_anything_and_the_controller_stands_alone():
    asked = []
    filtered = PaperFilter(INERTIAL, gain=lambda e, e_rate: asked.append((e, e_rate)) or 7.0)
    filtered.step(STILL, -INERTIAL, DT)
    assert asked == [(filtered.e, filtered.e_rate)]
    assert filtered.K == 7.0
    surface = [[filtered.fuzzy_gain(e, d) for e in (0.0, 0.5, 1.0)] for d in (-1.0, 0.0, 1.0)]
    assert np.all(np.diff(surface, axis=1) >= 0.0)  # more error, more gain
    assert 1.0 <= np.min(surface) < np.max(surface) <= 101.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[1, 0, 0]],), "fix no attitude"),
        (([[1, 0, 0], [0, 0, 0]],), "some length"),
        (([[1, 0, 0], [0, 1, 0], [1, 1, 0]],), "fix no attitude"),
        (([[1, 0], [0, 1]],), "shape"),
        ((INERTIAL, [1.0]), "s: must be 2 confidences"),
        ((INERTIAL, [1.0, -1.0]), "above 0"),
        ((INERTIAL, [1.0, np.inf]), "above 0"),
        ((INERTIAL, "ab"), "s: must be an array of numbers"),
    ],
)
def test_what_fixes_no_attitude_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        PaperFilter(*arguments)


@pytest.mark.parametrize("gain", [1e300, -1.0, np.nan, "loud", True, np.array([1.0, 2.0])])
def test_a_gain_beyond_what_a_profile_may_have_is_refused(gain):
    """Reported at once, or by the step that asks a function for it."""
    with pytest.raises(InputError, match=REFUSED):
        PaperFilter(INERTIAL, gain=gain)
    asked = PaperFilter(INERTIAL, gain=lambda *_: gain)
    with pytest.raises(InputError, match=REFUSED):
        asked.step(STILL, INERTIAL, DT)


@pytest.mark.parametrize(
    ("rate", "dt", "words"),
    [((0.0, np.nan, 0.0), DT, "Omega_m"), *((STILL, dt, "dt") for dt in (np.nan, -1.0, "0.01"))],
)
def test_a_step_of_no_numbers_is_refused_and_leaves_the_attitude(rate, dt, words):
    filtered = PaperFilter(INERTIAL)
    with pytest.raises(InputError, match=words):
        filtered.step(rate, INERTIAL, dt)
    assert np.array_equal(filtered.R_hat, np.eye(3))


def test_scipy_and_pandas_get_what_they_know():
    gyr, vectors, _ = signals(200)
    estimator = Estimator(load_profile("paper"), rate_hz=100.0)
    found = estimator.update_batch(gyr, -vectors[:, 1], vectors[:, 0])
    assert isinstance(found, Attitudes)
    turned = found.to_rotation().apply((1.0, 0.0, 0.0))
    yaw_deg = np.degrees(np.arctan2(turned[:, 1], turned[:, 0])) % 360.0
    assert yaw_deg == pytest.approx(found.euler_deg[:, 2], abs=1e-6)
    pytest.importorskip("pandas")
    frame = found.to_frame()
    assert len(frame) == 200
    assert frame["yaw_deg"].iloc[-1] == pytest.approx(yaw_deg[-1])


@pytest.mark.parametrize("k", [load_profile("paper").k, midpoint()], ids=["paper", "midpoint"])
def test_it_equals_the_compiled_inference(k):
    from skfuzzy.control import ControlSystemSimulation

    from estimator.filter.fuzzy import fuzzy_gain
    from fuzzbee.controller import control_system

    simulation = ControlSystemSimulation(control_system(k, 100_001), cache=False)
    places = ((0.03, 0.1), (0.2, 0.05), (0.5, 0.02), (0.01, 0.6), (0.12, 0.12), (0.0, 0.0))
    for error, rate in places:
        simulation.input["error"], simulation.input["error_rate"] = error, rate
        simulation.compute()
        assert simulation.output["k_op"] == pytest.approx(fuzzy_gain(k, error, rate), rel=1e-9)


def test_the_paper_s_filter_hands_it_out():
    system = PaperFilter(np.eye(3)[:2]).controller()
    assert len(list(system.rules)) == 25
    labels = {variable.label for variable in system.fuzzy_variables}
    assert labels == {"error", "error_rate", "k_op"}


def test_a_profile_is_drawn(tmp_path, printed, refused):
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    show, file = ("profile", "show", "paper", "--plot"), tmp_path / "rules.png"
    printed(*show, file)
    assert file.read_bytes().startswith(b"\x89PNG")
    assert "should end in" in refused(*show, tmp_path / "rules.doc")
