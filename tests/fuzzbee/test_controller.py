"""The fuzzy controller as scikit-fuzzy's own objects."""

import numpy as np
import pytest

from estimator.filter.memberships import midpoint
from estimator.profile import load_profile
from fuzzbee import PaperFilter
from fuzzbee.cli import main

PLACES = ((0.03, 0.1), (0.2, 0.05), (0.5, 0.02), (0.01, 0.6), (0.12, 0.12), (0.0, 0.0))


@pytest.mark.parametrize("k", [load_profile("paper").k, midpoint()], ids=["paper", "midpoint"])
def test_it_equals_the_compiled_inference(k):
    from skfuzzy.control import ControlSystemSimulation

    from estimator.filter.fuzzy import fuzzy_gain
    from fuzzbee.controller import control_system

    simulation = ControlSystemSimulation(control_system(k, 100_001), cache=False)
    for error, rate in PLACES:
        simulation.input["error"], simulation.input["error_rate"] = error, rate
        simulation.compute()
        assert simulation.output["k_op"] == pytest.approx(fuzzy_gain(k, error, rate), rel=1e-9)


def test_the_paper_s_filter_hands_it_out():
    made = PaperFilter(np.eye(3)[:2])
    system = made.controller()
    assert len(list(system.rules)) == 25
    assert {variable.label for variable in system.fuzzy_variables} == {
        "error",
        "error_rate",
        "k_op",
    }


def test_a_profile_is_drawn(tmp_path, capfd):
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    file = tmp_path / "rules.png"
    assert main(["profile", "show", "paper", "--plot", str(file)]) == 0
    assert file.read_bytes().startswith(b"\x89PNG")
    assert main(["profile", "show", "paper", "--plot", str(tmp_path / "rules.doc")]) == 2
    assert "should end in" in capfd.readouterr().err
