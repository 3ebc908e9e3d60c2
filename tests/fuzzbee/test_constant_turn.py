"""A constant turn between estimate and reference: found, told, and taken off."""

import numpy as np
import pytest

from estimator.geometry.rotations import exp, multiply
from fuzzbee.cli import main
from fuzzbee.replays.constant_turn import Turned, constant_turn
from tests.fuzzbee.test_replay import DATA, replay

N = 400
RNG = np.random.default_rng(3)
REFERENCE = exp(RNG.uniform(-0.5, 0.5, (N, 3)))
MOUNTED_RAD = np.tile([0.04, -0.03, 0.0], (N, 1))  # 0.05 rad: 2.9 deg
NOISE_RAD = 0.004 * RNG.standard_normal((N, 3))
MOVED = np.arange(N) >= 100


def test_a_mounting_is_found_and_the_noise_is_left():
    """Of a turn of 2.9 deg about a level axis a leaning body feels nearly all."""
    estimates = multiply(REFERENCE, exp(MOUNTED_RAD + NOISE_RAD))
    sigma = np.where(MOVED, 0.006, 0.02)
    whole = Turned(estimates, REFERENCE, sigma, MOVED)
    found = constant_turn(lambda: [whole])
    assert found is not None
    assert found.turn_deg == pytest.approx(2.8, rel=0.03)
    assert found.inclination_rms == pytest.approx(np.degrees(0.004 * np.sqrt(2.0)), rel=0.1)
    assert found.inclination_coverage_moving == pytest.approx(0.68, abs=0.06)
    assert found.inclination_coverage == pytest.approx(0.75 * 0.68 + 0.25, abs=0.06)


def test_without_samples_or_motion_nothing_is_told():
    rested = Turned(REFERENCE, REFERENCE, np.full(N, 0.01), np.zeros(N, bool))
    assert constant_turn(lambda: [Turned(*(column[:0] for column in rested))]) is None
    still = constant_turn(lambda: [rested])
    assert still is not None
    assert still.turn_deg == pytest.approx(0.0, abs=1e-6)
    assert still.inclination_coverage_moving is None


def test_it_stands_beside_the_scores(capsys):
    log = DATA / "sub_bluerov.tlog"
    _, report, _ = replay(capsys, log, "--json")
    turn = report["constant_turn"]
    assert turn["inclination_rms"] < report["error_deg"]["inclination_rms"]
    assert turn["inclination_coverage"] > report["coverage"]["inclination"]
    assert main(["replay", str(log)]) == 0
    out, _ = capsys.readouterr()
    assert f"{turn['turn_deg']:.1f}° of it is a constant turn" in " ".join(out.split())
