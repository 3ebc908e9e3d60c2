"""Segments: cut out of a flight, flown again, and what a candidate costs on them."""

import numpy as np
import pytest

from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from estimator.types import ImuSample
from tests.paper_noise import NoiseScale, simulate_scaled
from tuning.course import WRONG_TURN
from tuning.online.cost import Cost, cost_on
from tuning.online.noise import Noise, is_disturbed, noise_of
from tuning.online.numbers import MOST_FACTOR, MOST_MOVE, space_around, with_factors
from tuning.online.retuned_estimator import RetunedEstimator
from tuning.online.retuner import CHANGED, MOST_FOREIGN, Retuner, Trial
from tuning.online.segment import LONGEST_GAP_S, SEGMENT_S, fly_segments
from tuning.prediction import Readings

PAPER = load_profile("paper")
OTHER = with_factors(PAPER, np.array([0.3, 2.0]))


def told(seconds, profile=PAPER, late_at_s=None, late_s=0.0, scale=None):
    """The paper's signals to an estimator: its segments, and its attitudes (N, 4)."""
    made, parts, rows = simulate_scaled(3, round(100 * seconds), scale or NoiseScale()), [], []
    estimator = RetunedEstimator(profile, on_segment=parts.append)
    for k in range(len(made.time_us)):
        late_us = round(1e6 * late_s) if late_at_s is not None and k >= 100 * late_at_s else 0
        columns = (made.gyr_rad_s[k], made.acc_m_s2[k], made.mag_gauss[k])
        readings = [tuple(column.tolist()) for column in columns]
        sample = ImuSample(int(made.time_us[k]) + late_us, *readings, True)
        estimator.update(sample)
        rows.append(estimator.attitude(sample.time_us).q_ned_frd)
    return parts, np.array(rows)


def test_a_segment_flown_again_is_what_it_was_and_another_profile_changes_it():
    """To the last bit; each has five seconds and one sample."""
    parts, said = told(16.0)
    n = len(parts[0].samples)
    assert n == round(100 * SEGMENT_S) + 1
    again = fly_segments(PAPER, (parts[1], parts[2])).q_ned_frd
    assert np.array_equal(again, said[n : 3 * n])
    assert np.array_equal(fly_segments(PAPER, (parts[1],), most=7).q_ned_frd, said[n : n + 7])
    other = fly_segments(OTHER, (parts[1],)).q_ned_frd
    assert batch_angle_errors(other, again[:n])[:, 0].max() > 0.01


def test_a_wrong_start_is_wrong_by_the_turn_and_comes_back():
    """The first attitude comes behind a step of the filter."""
    parts, _ = told(11.0)
    right = fly_segments(PAPER, (parts[1],)).q_ned_frd
    wrong = fly_segments(PAPER, (parts[1],), WRONG_TURN).q_ned_frd
    off_deg = np.degrees(batch_angle_errors(wrong, right)[:, 0])
    assert 150.0 < off_deg[0] <= 170.1
    assert off_deg[-1] < 10.0


@pytest.mark.parametrize(("late_s", "silent"), [(LONGEST_GAP_S + 0.05, True), (0.3, False)])
def test_a_gap_makes_a_segment_silent(late_s, silent):
    parts, _ = told(11.0, late_at_s=8.0, late_s=late_s)
    assert [part.silent for part in parts] == [True, silent]  # the first begins without attitude


def readings(scale, n=12_000):
    made = simulate_scaled(11, n, scale)
    has_mag = np.ones(n, dtype=bool)
    time_s = 1e-6 * (made.time_us - made.time_us[0])
    columns = (made.gyr_rad_s, made.acc_m_s2, made.mag_gauss)
    return Readings(time_s, *columns, has_mag), made.q_ned_frd


@pytest.mark.parametrize(("vectors", "low", "high"), [(0.0, 0.0, 0.1), (5.0, 0.6, 1.0)])
def test_the_share_of_the_prediction_that_is_the_readings_noise_is_known(vectors, low, high):
    """Of quiet vectors nothing; of noisy ones most, beside what they do to the attitude."""
    parts, _ = told(16.0, scale=NoiseScale(1.0, vectors))
    cost = cost_on(PAPER, parts[1], parts[2])
    assert low < cost.noise / cost.blocks.mean() < high


def test_the_noise_of_the_later_readings_is_theirs_alone():
    given, _ = readings(NoiseScale(1.0, np.repeat([0.5, 3.0], 6_000)))
    later = noise_of(Readings(*(column[6_000:] for column in given)))
    assert noise_of(given, 6_000) == later
    assert later.gravity > 10.0 * noise_of(Readings(*(c[:6_000] for c in given))).gravity


def test_a_cost_is_the_prediction_s_beyond_the_noise_and_a_share_of_the_pull_in():
    assert Cost(np.array([0.02, 0.04]), 0.01, 0.6).total == pytest.approx(0.02 + 0.6 / 300)
    assert Cost(np.array([0.02, 0.04]), 0.05, 0.6).total == pytest.approx(0.6 / 300)


def test_a_candidate_is_judged_on_the_later_segment_alone():
    parts, _ = told(16.0)
    judged, searched = cost_on(PAPER, parts[1], parts[2]), cost_on(PAPER, parts[1])
    assert len(judged.blocks) == len(searched.blocks) == 10  # all but the first half second
    assert not np.array_equal(judged.blocks, searched.blocks)


def trial(blocks, saved, spread):
    """A candidate that saves ``saved`` of a cost of 1, with that spread between half seconds."""
    offs = saved + spread * np.sqrt((blocks - 1) / blocks) * np.tile([-1.0, 1.0], blocks // 2)
    old = Cost(np.ones(blocks), 0.0, 0.0)
    return Trial(np.ones(2), CHANGED).with_costs(old, Cost(1.0 - offs, 0.0, 0.0))


@pytest.mark.parametrize(
    ("blocks", "saved", "won"),
    [(100, 0.1, True), (36, 0.1, False), (100, 0.07, False), (100, -0.1, False)],
)
def test_a_candidate_wins_beyond_chance_only(blocks, saved, won):
    """Student's t is saved / (0.4 / sqrt(blocks)): 2.5, 1.5, 1.75 and -2.5; 2 is needed."""
    assert trial(blocks, saved, 0.4).has_won == won


def test_a_candidate_wins_by_five_percent_only():
    assert trial(10_000, 0.06, 0.4).has_won
    assert not trial(10_000, 0.04, 0.4).has_won  # t = 10


def test_a_move_is_bounded_and_so_is_what_moves_lead_to():
    space = space_around(PAPER, np.array([1.0, 1.0]))
    assert space.lower == pytest.approx((1 / MOST_MOVE,) * 2)
    assert space.upper == pytest.approx((MOST_MOVE,) * 2)
    edge = space_around(PAPER, np.array([1.5 / MOST_FACTOR, MOST_FACTOR / 1.5]))
    assert edge.lower == pytest.approx((1 / MOST_FACTOR, MOST_FACTOR / 1.5 / MOST_MOVE))
    assert edge.upper == pytest.approx((1.5 / MOST_FACTOR * MOST_MOVE, MOST_FACTOR))


def test_a_profile_is_somebody_elses_only_after_as_many_segments_as_a_decision_takes():
    retuner = Retuner(PAPER)
    parts, _ = told(5.2 * (MOST_FOREIGN + 1), OTHER)
    for number, part in enumerate(parts, start=1):
        assert retuner.take(part) is None
        now = OTHER if number > MOST_FOREIGN else PAPER
        assert retuner.profile.confidence == now.confidence
    assert number == MOST_FOREIGN + 1


@pytest.mark.parametrize(
    ("strength", "angle_rad", "is_another"),
    [
        (0.5, 0.5, False),
        (0.59, 0.5, False),
        (0.61, 0.5, True),
        (0.41, 0.5, False),
        (0.39, 0.5, True),
        (0.5, 0.74, False),
        (0.5, 0.76, True),
        (0.5, 0.24, True),
    ],
)
def test_a_field_is_another_by_its_strength_or_its_angle_to_gravity(
    strength, angle_rad, is_another
):
    learnt = Noise(0.01, 0.01, 0.01, 0.5, 0.5)
    now = learnt._replace(strength=strength, angle_rad=angle_rad)
    assert is_disturbed(learnt, now) is is_another
    assert not is_disturbed(learnt._replace(strength=0.0), now)


def test_the_fields_angle_to_gravity_is_that_to_down():
    """At rest; the field dips 60 degrees, so it is 30 degrees from down."""
    n = 50
    acc, mag = np.tile((0.0, 0.0, -9.8), (n, 1)), np.tile((0.15, -0.2, 0.25 * 3**0.5), (n, 1))
    given = Readings(0.01 * np.arange(n), np.zeros((n, 3)), acc, mag, np.ones(n, bool))
    found = noise_of(given)
    assert found.angle_rad == pytest.approx(np.pi / 6.0)
    assert found.strength == pytest.approx(0.5)
    assert (found.gravity, found.magnetic, found.gyroscope) == pytest.approx((0.0, 0.0, 0.0))
