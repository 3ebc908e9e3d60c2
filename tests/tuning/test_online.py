"""Retuning while it runs: by what proof, how far, and when not; on the paper's signals, 100 Hz."""

from dataclasses import replace

import numpy as np
import pytest

from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.live.rows import rows_of
from estimator.profile import load_profile, profile_to_json
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample
from tests.paper_noise import NoiseScale, samples_of, simulate_scaled
from tuning.calls import WRONG_TURN, LoggedEstimator
from tuning.online import retuner
from tuning.online.retuner import MOST_FACTOR, MOST_MOVE, RetunedEstimator, update_of
from tuning.online.segment import (
    LONGEST_GAP_S,
    SEGMENT_S,
    cost_on,
    fly_again,
    has_moved,
    joined,
    noise_of,
)

PAPER = load_profile("paper")
CHANGE_S = 20.0


def changed(made, late_us=lambda _: 0, turned=lambda _: False):
    """Samples, those for which it is so late, or with force and field turned."""
    for sample in samples_of(made):
        time_s, (force, field) = 1e-6 * sample.time_us, sample[2:4]
        if turned(time_s):
            force, field = force[1:] + force[:1], field[1:] + field[:1]
        time_us = sample.time_us + late_us(time_s)
        yield sample._replace(time_us=time_us, acc_m_s2=force, mag_gauss=field)


def flown(
    duration_s, vectors=1.0, gyroscope=1.0, until_s=np.inf, seed=400, look=None, retune=True, **more
):
    """An estimator after the paper's signals, its attitudes, and the mean of e since the change."""
    time_s = 0.01 * np.arange(round(100 * duration_s))
    is_noisy = (time_s >= CHANGE_S) & (time_s < until_s)
    scale = NoiseScale(*(np.where(is_noisy, each, 1.0) for each in (gyroscope, vectors)))
    made = simulate_scaled(seed, len(time_s), scale)
    given = retuner.Retuner(PAPER, seed, *([] if look is None else [look]))
    estimator = RetunedEstimator(PAPER, retuner=given) if retune else Estimator(PAPER)
    q = np.empty((len(time_s), 4))
    for k, sample in enumerate(changed(made, **more)):
        estimator.update(sample)
        q[k] = estimator.attitude(sample.time_us).q_ned_frd
    angles = batch_angle_errors(q, made.q_ned_frd)[time_s >= CHANGE_S, 0]
    return estimator, q, float(np.mean(np.sin(0.5 * angles) ** 2))


def times_s(estimator):
    return [round(1e-6 * time_us, 1) for time_us, _ in estimator.decisions]


@pytest.mark.parametrize(("vectors", "gyroscope", "share"), [(5.0, 1.0, 0.85), (5.0, 5.0, 0.9)])
def test_more_noise_is_answered_by_the_colony_and_again_alike(vectors, gyroscope, share):
    estimator, q, e = flown(60.0, vectors, gyroscope)
    assert e < share * flown(60.0, vectors, gyroscope, retune=False)[2]
    first = estimator.decisions[0][1]
    assert times_s(estimator)[0] >= CHANGE_S + 2 * SEGMENT_S
    assert first.gain > retuner.LEAST_GAIN
    gravity = first.update["confidence"]["gravity"] / PAPER.confidence.gravity
    assert 1.0 / MOST_MOVE - 1e-9 <= gravity < 0.7
    assert first.update["confidence"]["cross"] == pytest.approx(gravity)
    again, same, _ = flown(60.0, vectors, gyroscope)
    assert again.decisions == estimator.decisions
    assert np.array_equal(same, q)


def test_where_nothing_changes_nothing_is_changed_but_by_somebodys_own_profile():
    """To the last bit; that profile is the base from then on."""
    estimator, q, _ = flown(45.0)
    assert estimator.decisions == []
    assert np.array_equal(q, flown(45.0, retune=False)[1])
    estimator.replace_profile(own := load_profile("adaptive"))
    assert profile_to_json(estimator.retuner.profile) == profile_to_json(own)


def test_noise_that_is_over_is_followed_back():
    estimator, *_ = flown(100.0, vectors=5.0, until_s=50.2)
    gravity = [each.update["confidence"]["gravity"] for _, each in estimator.decisions]
    assert gravity[0] < 0.7
    assert gravity[-1] > 2.0 * min(gravity)


def test_what_does_not_hold_is_taken_back():
    """Both noises are over just when the colony has fitted the profile to them."""
    estimator, *_ = flown(60.0, vectors=5.0, gyroscope=5.0, until_s=35.2)
    reasons = [decision.reason for _, decision in estimator.decisions]
    assert reasons == ["noise has changed", "taken back"]
    back = estimator.decisions[1][1].update
    assert back["confidence"] == {"gravity": 1.0, "magnetic": 1.0, "cross": 1.0}


def test_nothing_is_changed_across_a_silence():
    """A silence of 0.8 s: its segment is not used, the first whole one behind it is."""
    estimator, *_ = flown(60.0, 5.0, late_us=lambda time_s: 800_000 * (time_s >= 27.0))
    assert times_s(estimator)[0] >= 27.0 + 2 * SEGMENT_S


def test_nothing_is_changed_by_an_event_that_is_no_noise():
    """A second in which force and field are turned by 120 deg."""
    usual, *_ = flown(45.0, 5.0)
    at_s = times_s(usual)[0] - 3.0
    estimator, *_ = flown(45.0, 5.0, turned=lambda time_s: at_s <= time_s < at_s + 1.0)
    assert all(time_s > at_s + 3.1 for time_s in times_s(estimator))


def test_a_bad_candidate_does_not_win():
    def worst(search, kept, generator):
        search.best_values = np.array([each.upper for each in search.space])
        return kept

    assert flown(45.0, 5.0, 5.0, look=worst)[0].decisions == []


def segments_of(seconds, late_us=lambda _: 0):
    """Segments of the paper's signals, and the attitudes (N, 4) that were said."""
    made, parts, output = simulate_scaled(3, round(100 * seconds), NoiseScale()), [], []
    estimator = RetunedEstimator(PAPER, on_segment=parts.append)
    for sample in changed(made, late_us):
        estimator.update(sample)
        output.append(estimator.attitude(sample.time_us).q_ned_frd)
    return parts, np.array(output)


def test_segments_flown_again_are_what_they_were_and_come_back_from_a_wrong_start():
    """To the last bit; each has five seconds and one sample."""
    parts, output = segments_of(16.0)
    n = len(parts[0].samples)
    assert n == round(100 * SEGMENT_S) + 1
    right = fly_again(PAPER, joined(parts[1], parts[2])).q_ned_frd
    assert np.array_equal(right, output[n : 3 * n])
    few = replace(parts[1], samples=parts[1].samples[:7])
    assert np.array_equal(fly_again(PAPER, few).q_ned_frd, output[n : n + 7])
    wrong = fly_again(PAPER, parts[1], WRONG_TURN).q_ned_frd
    off_deg = np.degrees(batch_angle_errors(wrong, right[:n])[:, 0])
    assert 150.0 < off_deg[0] <= 170.1
    assert off_deg[-1] < 10.0
    judged, searched = cost_on(PAPER, parts[2], joined(*parts[1:3])), cost_on(PAPER, parts[1])
    assert len(judged) == len(searched) == 10  # all but the first half second
    assert not np.array_equal(judged, searched)


@pytest.mark.parametrize(("late_s", "broken"), [(LONGEST_GAP_S + 0.05, True), (0.3, False)])
def test_a_gap_breaks_a_segment(late_s, broken):
    parts, _ = segments_of(11.0, late_us=lambda time_s: round(1e6 * late_s) * (time_s >= 8.0))
    assert [part.is_broken for part in parts] == [True, broken]  # the first begins without attitude


@pytest.mark.parametrize(
    ("blocks", "saved", "won"),
    [
        *((100, 0.1, True), (36, 0.1, False), (100, 0.07, False), (100, -0.1, False)),
        *((10_000, 0.06, True), (10_000, 0.04, False)),  # by five percent only
    ],
)
def test_a_candidate_wins_beyond_chance_and_by_enough(blocks, saved, won):
    """Student's t is saved / (0.4 / sqrt(blocks)): 2.5, 1.5, 1.75, -2.5, 15 and 10; 2 is needed."""
    offs = saved + 0.4 * np.sqrt((blocks - 1) / blocks) * np.tile([-1.0, 1.0], blocks // 2)
    costs = np.array([np.ones(blocks), 1.0 - offs])
    assert retuner.Trial(np.ones(2), retuner.CHANGED, (costs,)).has_won == won


def test_a_move_is_bounded_and_so_is_what_moves_lead_to():
    edge = retuner.space_around(PAPER, np.array([1.5 / MOST_FACTOR, MOST_FACTOR / 1.5]))
    low, high = zip(*((each.lower, each.upper) for each in edge), strict=True)
    assert low == pytest.approx((1 / MOST_FACTOR, MOST_FACTOR / 1.5 / MOST_MOVE))
    assert high == pytest.approx((1.5 / MOST_FACTOR * MOST_MOVE, MOST_FACTOR))


def test_factors_go_by_their_powers_and_leave_the_rest():
    assert update_of(PAPER, np.array([0.5, 3.0])) == {
        "confidence": {"gravity": 0.5, "magnetic": 0.5, "cross": 0.5},
        "filter": {"gamma": 3.0},
    }
    imu = load_profile("imu")
    twice = np.where(np.array([*retuner.numbers_of(imu)]) == "heading", 2.0, 1.0)
    before, after = (update_of(imu, factors)["conditioning"] for factors in (twice**0.0, twice))
    variance = "heading_noise_rad2_s"
    assert after[variance] == pytest.approx(4.0 * before[variance])


def readings(noise=1.0, step_us=10_000):
    made = simulate_scaled(5, 1000, NoiseScale(noise, noise))
    columns = (made.gyr_rad_s, made.acc_m_s2, made.mag_gauss)
    return rows_of(step_us * np.arange(1000), *columns, np.ones(1000, dtype=bool))


def test_noise_is_what_was_put_in_also_while_it_turns():
    """The paper's: 0.2 rad/s, 0.05 of each component of a unit vector."""
    given = readings()
    # across the vector; along it a unit vector has no noise
    assert noise_of(given) == pytest.approx([3 * 0.2**2, 2 * 0.05**2, 2 * 0.05**2], rel=0.2)
    assert (noise_of(readings(noise=0.0))[1:] < 1e-5).all()
    assert noise_of(readings(step_us=250_000)) is None
    known = abs(np.arange(1000) - 550) <= 250
    unread = given._replace(has_mag=known, mag_gauss=np.where(known[:, None], given.mag_gauss, 0.0))
    read = type(given)(*(column[known] for column in given))
    assert noise_of(unread)[2] == pytest.approx(noise_of(read)[2])


@pytest.mark.parametrize(
    ("noise", "field", "moved"),
    [(2.0, 1.0, True), (0.5, 1.0, True), (1.2, 1.0, False), (1.0, 1.4, False)],
)
def test_noise_has_moved_where_it_doubles_and_not_by_a_stronger_field(noise, field, moved):
    now = readings(noise)
    stronger = now._replace(mag_gauss=field * now.mag_gauss)
    assert has_moved(noise_of(readings()), noise_of(stronger)) == moved


# They change nothing, or are logged where segments are kept: a profile ends one. Nor does a
# property change anything.
NOT_LOGGED = {"attitude", "replace_profile"}
# In place of ``update``, for arrays of samples, which nobody retunes on.
OF_ARRAYS = {"take", "take_all", "update_rows", "put"}


def test_every_change_from_outside_is_logged():
    """A new method of the estimator is overridden in LoggedEstimator, or named here."""
    methods = {name for name, each in vars(Estimator).items() if not isinstance(each, property)}
    public = {name for name in methods if not name.startswith("_")}
    logged = {name for name in vars(LoggedEstimator) if not name.startswith("_")}
    assert public - logged == NOT_LOGGED | OF_ARRAYS


def test_of_samples_without_a_call_between_them_nothing_is_kept():
    """A call kept for each would take 800 bytes for each."""
    recorder = LoggedEstimator(load_profile("imu"))
    for k in range(100):
        if k == 50:
            recorder.update_report(VelocitySample(1000 * k, ZERO_VEC3, True, 0.5))
        recorder.update(ImuSample(1000 * k, ZERO_VEC3, (0.0, 0.0, -9.8), ZERO_VEC3, False))
    assert recorder.taken == 100
    assert [(k, len(calls)) for k, calls in recorder.calls.items()] == [(50, 1)]
