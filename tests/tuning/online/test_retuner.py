"""Retuning while it runs: by what proof, how far, and when not; on the paper's signals, 100 Hz."""

import numpy as np
import pytest

from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from estimator.types import ImuSample
from tests.paper_noise import NoiseScale, simulate_scaled
from tuning.online.numbers import MOST_MOVE, RAW, numbers_of, update_of
from tuning.online.retuned_estimator import RetunedEstimator
from tuning.online.retuner import Retuner
from tuning.online.segment import SEGMENT_S

PAPER = load_profile("paper")
CHANGE_S = 20.0


def flown(
    duration_s,
    vectors=1.0,
    until_s=np.inf,
    seed=400,
    gap_at_s=None,
    event_at_s=None,
    look=None,
    gyroscope=1.0,
):
    """A retuned estimator after the paper's signals, and the mean of e since the change."""
    n = int(100 * duration_s)
    time_s = 0.01 * np.arange(n)
    changed = (time_s >= CHANGE_S) & (time_s < until_s)
    scale = NoiseScale(np.where(changed, gyroscope, 1.0), np.where(changed, vectors, 1.0))
    made = simulate_scaled(seed, n, scale)
    retuner = Retuner(PAPER, seed) if look is None else Retuner(PAPER, seed, look)
    estimator, q = RetunedEstimator(PAPER, retuner=retuner), np.empty((n, 4))
    plain, p = Estimator(PAPER), np.empty((n, 4))
    for k in range(n):
        late_us = 800_000 if gap_at_s is not None and time_s[k] >= gap_at_s else 0
        columns = (made.gyr_rad_s[k], made.acc_m_s2[k], made.mag_gauss[k])
        readings = [tuple(column.tolist()) for column in columns]
        if event_at_s is not None and event_at_s <= time_s[k] < event_at_s + 1.0:
            readings[1:] = [(y, z, x) for x, y, z in readings[1:]]
        sample = ImuSample(int(made.time_us[k]) + late_us, *readings, True)
        for one, rows in ((estimator, q), (plain, p)):
            one.update(sample)
            rows[k] = one.attitude(sample.time_us).q_ned_frd
    since = time_s >= CHANGE_S
    e, base = (np.sin(0.5 * batch_angle_errors(a, made.q_ned_frd)[since, 0]) ** 2 for a in (q, p))
    return estimator, q, float(e.mean()), float(base.mean())


def times_s(estimator):
    return [round(1e-6 * time_us, 1) for time_us, _ in estimator.decisions]


def test_more_noise_is_answered_by_the_colony_and_again_alike():
    """Vectors x5: -28 % of e here, once two segments have shown the noise."""
    estimator, q, e, base = flown(60.0, vectors=5.0)
    assert e < 0.8 * base
    first_s, (_, first) = times_s(estimator)[0], estimator.decisions[0]
    assert first_s >= CHANGE_S + 2 * SEGMENT_S
    assert first.gain > 0.05
    gravity = first.update["confidence"]["gravity"] / PAPER.confidence.gravity
    assert 1.0 / MOST_MOVE - 1e-9 <= gravity < 0.6
    assert first.update["confidence"]["cross"] == pytest.approx(gravity)
    again, same, *_ = flown(60.0, vectors=5.0)
    assert again.decisions == estimator.decisions
    assert np.array_equal(same, q)


def test_both_noises_are_answered():
    """Both x5: -23 % of e, once ten seconds have shown it."""
    estimator, _, e, base = flown(60.0, vectors=5.0, gyroscope=5.0)
    assert e < 0.9 * base
    first_s, (_, first) = times_s(estimator)[0], estimator.decisions[0]
    assert first_s >= CHANGE_S + 2 * SEGMENT_S
    assert first.gain > 0.05
    gravity = first.update["confidence"]["gravity"] / PAPER.confidence.gravity
    assert 1.0 / MOST_MOVE - 1e-9 <= gravity <= MOST_MOVE


def test_where_nothing_changes_nothing_is_changed():
    """To the last bit."""
    estimator, _, e, base = flown(45.0)
    assert estimator.decisions == []
    assert e == base


def test_noise_that_is_over_is_followed_back():
    estimator, *_ = flown(90.0, vectors=5.0, until_s=50.2)
    gravity = [each.update["confidence"]["gravity"] for _, each in estimator.decisions]
    assert gravity[0] < 0.6
    assert gravity[-1] == pytest.approx(1.0, rel=0.2)


def test_what_does_not_hold_is_taken_back():
    """Both noises are over just when the colony has fitted the profile to them."""
    estimator, *_ = flown(52.0, vectors=5.0, gyroscope=5.0, until_s=40.2)
    reasons = [decision.reason for _, decision in estimator.decisions]
    assert reasons == ["noise has changed", "taken back"]
    back = estimator.decisions[1][1].update
    assert back["confidence"] == {"gravity": 1.0, "magnetic": 1.0, "cross": 1.0}


def test_nothing_is_changed_across_a_silence():
    """A silence of 0.8 s: its segment is not used, the first whole one behind it is."""
    estimator, *_ = flown(46.0, vectors=5.0, gap_at_s=22.0)
    assert times_s(estimator)[0] >= 22.0 + SEGMENT_S


def test_nothing_is_changed_across_an_event_that_is_no_noise():
    """A second in which force and field are turned by 120 deg; without it a move comes at 25 s."""
    estimator, *_ = flown(42.0, vectors=5.0, event_at_s=22.0)
    assert all(time_s > 27.0 for time_s in times_s(estimator))


def test_a_bad_candidate_does_not_win():
    def worst(space, kept, evaluate, generator):
        return np.array([space.upper]), np.zeros(1), kept

    estimator, _, e, base = flown(45.0, vectors=5.0, gyroscope=5.0, look=worst)
    assert estimator.decisions == []
    assert e == base


def test_factors_go_by_their_powers_and_leave_the_rest():
    assert [*RAW] == ["gain", "gamma"]
    update = update_of(PAPER, np.array([0.5, 3.0]))
    assert update == {
        "confidence": {"gravity": 0.5, "magnetic": 0.5, "cross": 0.5},
        "filter": {"gamma": 3.0},
    }
    imu = load_profile("imu")
    names = [*numbers_of(imu)]
    ones = np.ones(len(names))
    twice = np.where(np.array(names) == "heading", 2.0, ones)
    before = update_of(imu, ones)["conditioning"]["heading_noise_rad2_s"]
    after = update_of(imu, twice)["conditioning"]["heading_noise_rad2_s"]
    assert after == pytest.approx(4.0 * before)  # a variance
