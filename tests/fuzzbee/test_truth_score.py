"""The demo says how far it is off, what happens to it, and what it was worth; without waiting."""

import pytest

from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.profile import load_profile
from fuzzbee.truth_score import ScoredPipeline, TruthScore
from service.records import Message

PROFILES = {"flight": "imu", "turn": "paper"}


def flown(motion, seconds):
    """A pipeline after so long, and what it has told, on a clock that runs as fast as it can."""
    clock_us = [0]
    source = SimSource(
        SimulatedVehicle(0, 50.0, motion), monotonic_us=lambda: clock_us[0], unix_us=lambda: 0
    )
    pipeline = ScoredPipeline(load_profile(PROFILES[motion]), fits_built_in=True)
    pipeline.score = TruthScore(motion)
    told = []
    with source:
        while clock_us[0] < 1e6 * seconds:
            for event in source.drain(0.0):
                told += [each.text for each in pipeline.handle(event) if isinstance(each, Message)]
            clock_us[0] += 20_000
    return pipeline.score, told


def test_a_flight_is_told_as_it_goes_and_judged_at_its_end():
    score, told = flown("flight", 100.0)
    news = [line for line in told if line.startswith("now: ")]
    assert [line.split()[-1] for line in news] == ["wrong", "passes", "s"]
    doubts = [line for line in told if "±45°" in line]
    assert doubts == [
        "vehicle 1: heading ±45° until velocity shows it: the field is not like this place's"
    ]
    result = score.result()
    assert result["rms_deg"]["total"] == pytest.approx(0.98, rel=0.2)  # with the wrong start
    assert result["worst_deg"] == pytest.approx(15.6, rel=0.2)
    assert result["worst_when"] == "while it was set down by hand"
    assert min(result["coverage"].values()) > 0.8
    assert score.line.startswith("truth: 0.")
    verdict = score.verdict()
    assert "1.0° RMS" in verdict
    assert "while it was set down by hand" in verdict


def test_of_the_paper_s_signals_it_says_that_they_are_noisy():
    score, told = flown("turn", 10.0)
    assert "the paper's signals are that noisy" in score.verdict()
    assert not [line for line in told if line.startswith("now: ")]


def test_without_a_sample_there_is_no_verdict():
    assert TruthScore("flight").verdict() == ""
    assert TruthScore("flight").result() is None
