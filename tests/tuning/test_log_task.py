"""Tuning on recorded flights: what is scored is what ``replay`` says, and what a user sees."""

from contextlib import nullcontext as nothing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.rotations import exp, multiply
from estimator.live.rows import rows_of
from estimator.profile import load_profile, merge_profile
from fuzzbee import replay
from fuzzbee.replays.score import report_log
from fuzzbee.tune.read_flight import read_flight
from tests.fuzzbee.recording import DATA, SLOW
from tuning.calls import WRONG_TURN, Call
from tuning.flight import Flight, fly, require_substance, sure_flight
from tuning.flight_cost import (
    Figure,
    FlightFigures,
    geometric_mean,
    harm,
    measure,
    possible_truths,
    score_errors,
)
from tuning.prediction import AHEAD_S, heading_errors, predicted_vectors
from tuning.recovery import RECOVERY_S, SETTLE_S, recoveries, recovery_cost, recovery_errors
from tuning.task import LATER_PART, default_groups, split

LOGS = sorted(path for path in DATA.iterdir() if path.suffix in (".tlog", ".ulg", ".bin"))


def imu(**changes):
    return merge_profile(load_profile("imu"), changes)


@pytest.fixture(scope="module")
def recorded():
    return read_flight(SLOW, imu())


def flight(rate_hz=50.0, duration_s=80.0, seed=3):
    """The simulated vehicle; the declination makes the learnt north agree with the truth."""
    n = int(rate_hz * duration_s)
    flown, every = simulate(seed, n, rate_hz, noise=0.3, bias=0.1), np.ones(n, dtype=bool)
    times_us = np.round(1e6 * np.arange(n) / rate_hz).astype(np.int64)
    rows = rows_of(times_us, flown.gyr_rad_s, flown.acc_m_s2, flown.mag_gauss, every)
    named = (Path("flight"), f"{seed}", "RAW_IMU", "sim")
    return Flight(*named, rows, {}, flown.q_ned_frd, known=every, headed=every.copy())


def test_a_flight_is_scored_as_replay_scores_it(recorded):
    """To the last digit: the same calls to the same estimator, aided by velocity in this flight."""
    _, report = report_log(SLOW, imu())
    for angle, figure in zip(("inclination", "heading"), measure(imu(), recorded)[:2], strict=True):
        assert figure.rms_deg == getattr(report.error_deg, f"{angle}_rms")
        assert figure.coverage == getattr(report.coverage, angle)
    named = {call.method for calls in recorded.calls.values() for call in calls}
    assert "set_position" in named
    assert len(recorded.reports) > 100
    assert (recorded.reference, recorded.message) == ("sim", "RAW_IMU")
    assert recorded.rate_hz == pytest.approx(4.0, abs=0.2)
    assert recorded.known.mean() > 0.95
    assert recorded.restart[0]


@pytest.mark.parametrize("scale", [0.3, 0.7, 1.4, 3.0])
def test_an_honest_sigma_is_the_cheapest(scale):
    """68.3 % of normal errors lie under one sigma."""
    errors = np.abs(np.random.default_rng(2).normal(size=20_000))
    honest = score_errors(errors, np.ones(len(errors)))
    other = score_errors(errors, np.full(len(errors), scale))
    assert honest.coverage == pytest.approx(0.68, abs=0.01)
    assert other.rms_deg == honest.rms_deg
    assert other.cost > 1.01 * honest.cost
    assert score_errors(np.array([1.0, np.nan]), np.ones(2)).cost > 180.0  # no number costs most


def test_a_percent_of_a_good_flight_counts_as_much_as_of_a_bad_one():
    """Above a floor of 0.1 deg."""
    assert geometric_mean([0.8, 19.9]) == pytest.approx(geometric_mean([0.9, 17.9]), rel=1e-9)
    assert geometric_mean([0.8, 19.9]) < geometric_mean([0.9, 19.9])


def test_of_one_flight_the_later_part_is_held_out_of_several_every_third_or_those_named():
    flights = tuple(flight(rate_hz=2.0, seed=seed) for seed in range(5))
    (tuning,), (held_out,) = split(flights[:1])
    assert (tuning.window, held_out.window) == (slice(0, tuning.last), slice(tuning.last, 160))
    assert tuning.last == pytest.approx((1.0 - LATER_PART) * 160, abs=1.0)
    for named, apart in ((frozenset(), "14"), (frozenset("03"), "03")):
        tuning, held_out = split(flights, named)
        assert [each.sha256 for each in held_out] == [*apart]
        assert {each.sha256 for each in tuning} == {*"01234"} - {*apart}


def test_without_a_reference_the_flight_must_foretell_its_own_vectors(recorded):
    """With the gyroscope's axes turned round the estimate cannot."""
    blind = recorded._replace(reference="none", known=np.zeros(len(recorded.truth), dtype=bool))
    reverse = blind.rows._replace(gyr_rad_s=-blind.rows.gyr_rad_s)
    good = measure(imu(), blind)
    bad = measure(imu(), blind._replace(rows=reverse))
    assert good.inclination.coverage is None
    assert bad.cost > 1.5 * good.cost


def test_recovery_is_dear_where_the_gain_is_small():
    """From 170 deg each 14 s; K = 1 needs seconds, K = 20 a fraction of one."""
    made = flight(duration_s=60.0)
    turned = merge_profile(imu(), {"reference": {"declination_deg": -45.0}})
    quick, slow = (
        recovery_cost(merge_profile(turned, {"filter": {"gain": "fixed", "fixed_gain": k}}), made)
        for k in (20.0, 1.0)
    )
    assert slow > 1.5 * quick
    assert quick > 0.3 * 10  # at least a tenth of the first second is lost


def test_the_estimate_is_set_wrong_by_a_turn_seen_from_ned():
    """Without a field the inclination counts: that of the turn itself, however the vehicle lies."""
    made = flight()
    made = made._replace(rows=made.rows._replace(has_mag=np.zeros(len(made.truth), dtype=bool)))
    found = recoveries(made)
    w, _, _, z = WRONG_TURN
    expected = 1.0 - (w * w + z * z)  # sin^2 of half the angle between down and down turned
    errors = recovery_errors(imu(), made, found)[[each.first for each in found]]
    assert errors == pytest.approx(expected, rel=1e-6)
    # of rates that are no numbers no sample is taken: it is as wrong as can be
    unread = made._replace(rows=made.rows._replace(gyr_rad_s=np.nan * made.rows.gyr_rad_s))
    assert (recovery_errors(imu(), unread, []) == 1.0).all()


def test_recoveries_follow_each_other_after_the_settling():
    made = flight()
    time_s, found = made.time_s, recoveries(made)
    assert default_groups("recovery", made.rate_hz) == ("membership",)
    assert time_s[found[0].first] == pytest.approx(SETTLE_S)
    assert all(b.first == a.last + 1 for a, b in pairwise(found))
    lasting = [time_s[last] - time_s[first] for first, last, _ in found]
    assert lasting == pytest.approx([RECOVERY_S] * 4)  # of 701 samples each, in 70 s
    later = recoveries(made._replace(first=2000, last=4000))
    assert time_s[later[0].first] == pytest.approx(time_s[2000] + SETTLE_S)
    known = made.known.copy()
    known[700:900] = False
    assert len(recoveries(made._replace(known=known))) == 3
    with pytest.raises(InputError, match="no stretch of 14 s"):
        recoveries(flight(duration_s=20.0))


def test_no_recovery_crosses_a_restart_or_a_silence():
    made = flight()
    late_us = made.rows.times_us + 5_000_000 * (np.arange(len(made.truth)) >= 3000)
    calls = {1200: [Call("restart")]}
    made = made._replace(calls=calls, rows=made.rows._replace(times_us=late_us))
    found = recoveries(made)
    slow = flight(rate_hz=2.0)  # three of its periods are no silence
    late_us = slow.rows.times_us + 1_000_000 * (np.arange(len(slow.truth)) >= 60)
    late = slow._replace(rows=slow.rows._replace(times_us=late_us))
    assert len(recoveries(late)) == len(recoveries(slow))
    for first, last, _ in found:
        assert not made.restart[first + 1 : last + 1].any()
        assert np.diff(made.time_s[first : last + 1]).max() < 1.0
    assert any(made.time_s[s.first] == pytest.approx(made.time_s[1200] + SETTLE_S) for s in found)


@pytest.mark.parametrize("rate_hz", [2.0, 4.0, 50.0, 100.0])
def test_weights_sum_to_the_papers_at_any_rate(rate_hz):
    """0.3 x 101 samples of the first second and 1001 of 4..14 s."""
    made = flight(rate_hz=rate_hz)
    first, last, w = recoveries(made)[0]
    t = made.time_s[first : last + 1] - made.time_s[first]
    assert w.sum() == pytest.approx(0.3 * 101 + 1001)
    assert w[t < 1.0 + 1e-9].sum() == pytest.approx(0.3 * 101)
    assert (w[(t > 1.01) & (t < 3.99)] == 0.0).all()


def test_motion_is_turning_beyond_the_bias():
    """Of 80 s it turns for 9 or 11, at 0.2 rad/s; the gyroscope shows 0.1 rad/s all the time."""
    made = flight()
    for seconds in (11, 9):
        turning = np.arange(len(made.truth)) < 50 * seconds
        rates = np.array([0.06, -0.08, 0.0]) + np.outer(turning, [0.0, 0.12, 0.16])
        turned = made._replace(rows=made.rows._replace(gyr_rad_s=rates))
        with pytest.raises(InputError, match="rad/s for 9 s") if seconds < 10 else nothing():
            require_substance(turned)


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_a_log_in_rows_says_what_its_replay_says(path):
    """Replay takes each sample and report by itself, as the live service does."""
    profile = load_profile("imu")
    try:
        flight = read_flight(path, profile, "autopilot")
    except InputError:
        flight = read_flight(path, profile)
    course, found = fly(flight, profile), replay(path, profile).attitudes
    assert np.array_equal(course.q_ned_frd, found.q_ned_frd)
    assert np.array_equal(course.bias_rad_s, found.gyro_bias_rad_s)
    sigmas = (found.sigma_inclination_rad, found.sigma_heading_rad)
    assert np.array_equal(course.sigma_rad, np.transpose(sigmas))


# --- what a tuned profile may not make worse

FINE = FlightFigures(Figure(2.0, 0.5, 0.70), Figure(4.0, 1.0, 0.65))
SAME_ELSEWHERE = FlightFigures(Figure(1.0, 0.2, 0.95), None)


def changed(angle, **fields):
    return FINE._replace(**{angle: getattr(FINE, angle)._replace(**fields)})


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (FINE, FINE, None),
        (FINE, changed("inclination", rms_deg=1.9), None),
        # from one end of what is honest to the other, hardly outside, and nearer to it
        (FINE, changed("heading", coverage=0.76), None),
        (FINE, changed("heading", coverage=0.59), None),
        (changed("heading", coverage=0.3), changed("heading", coverage=0.5), None),
        (FINE, changed("inclination", rms_deg=2.1), "error rises from 2.016 to 2.049"),
        (FINE, changed("inclination", coverage=0.57), "coverage of 0.70 becomes 0.57"),
        (FINE, changed("heading", coverage=0.79), "coverage of 0.65 becomes 0.79"),
        (FINE, FINE._replace(heading=None), "error rises"),
    ],
)
def test_an_error_that_rises_or_a_sigma_that_lies_is_harm(before, after, words):
    output = harm([before, SAME_ELSEWHERE], [after, SAME_ELSEWHERE])
    assert output is None if words is None else words in output


def test_one_flight_may_be_worse_if_the_others_are_better_by_more():
    """Errors are weighed over all; coverage holds on each."""
    before, better = [FINE, FINE], changed("inclination", rms_deg=1.5)
    worse = changed("inclination", rms_deg=2.2)
    assert harm(before, [better, worse]) is None
    assert harm(before, [better, worse._replace(heading=Figure(4.0, 1.0, 0.5))]) is not None


def test_truths_lie_around_a_reference_as_its_sigmas_say():
    rng = np.random.default_rng(5)
    q = rng.normal(size=(200, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    truths = list(possible_truths(q, np.tile([0.02, 0.05], (200, 1))))
    errors = np.concatenate([batch_angle_errors(q, truth) for truth in truths])
    # means of eighths of a distribution; its tails are cut a little
    assert np.mean(errors[:, 1] <= 0.05) == pytest.approx(0.68, abs=0.07)
    assert np.mean(errors[:, 2] <= 0.02) == pytest.approx(0.68, abs=0.07)
    assert rms(errors[:, 1]) == pytest.approx(0.05 / 0.994, rel=0.1)
    assert rms(errors[:, 2]) == pytest.approx(0.02 * 2**0.5 / 1.51, rel=0.1)
    assert np.array_equal(next(possible_truths(q, None)), q)


def test_the_whole_flight_knows_better_and_how_well(recorded):
    smooth = sure_flight(recorded, imu(), is_wanted=False)
    assert smooth.reference == "smooth"
    known = smooth.known & smooth.headed
    assert known.mean() > 0.8
    errors = batch_angle_errors(smooth.truth, recorded.truth)[known]
    assert np.degrees(rms(errors[:, 2])) < 0.8 * measure(imu(), recorded).inclination.rms_deg
    by_smooth = measure(imu(), smooth)
    # without its sigma the reference, made of the same samples, is far too near
    sure = measure(imu(), smooth._replace(truth_sigma_rad=None))
    assert sure.inclination.coverage > 0.95
    assert 0.5 < by_smooth.inclination.coverage < 0.8
    assert by_smooth.inclination.rms_deg > 1.5 * sure.inclination.rms_deg
    # where the base profile reports no heading there is none
    reported = np.arange(len(recorded.headed)) < 100
    part_headed = sure_flight(recorded._replace(headed=reported), imu(), is_wanted=False)
    assert part_headed.reference == "smooth"
    assert not part_headed.headed[100:].any()


def test_what_is_not_sure_is_no_reference():
    """A submarine at 2 Hz, whose heading the whole log knows to more than 5 deg."""
    flight = read_flight(DATA / "sub_bluerov.tlog", imu())
    assert flight.reference == "autopilot"
    assert sure_flight(flight, imu(), is_wanted=False) is flight
    with pytest.raises(InputError, match=r"--reference smooth: .* in 100 and 0 % only") as error:
        read_flight(DATA / "sub_bluerov.tlog", imu(), "smooth")
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="no reference 'sim'"):
        read_flight(DATA / "sub_bluerov.tlog", imu(), "sim")


@pytest.mark.parametrize("wanted", ["smooth", "autopilot"])
def test_another_reference_than_the_best_is_taken_where_it_is_wanted(wanted):
    assert read_flight(SLOW, imu(), wanted).reference == wanted


N = 1000
FLOWN = simulate(5, N, 100.0, noise=0.0, bias=0.0)
NO_BIAS = (0.0, 0.0, 0.0)


def foretold_errors(q=FLOWN.q_ned_frd, bias=NO_BIAS, named=NO_BIAS):
    """RMS of level and heading, deg, by a gyroscope with a bias and an estimate that names one."""
    vectors = (FLOWN.gyr_rad_s + bias, FLOWN.acc_m_s2, FLOWN.mag_gauss)
    rows = rows_of(10_000 * np.arange(N), *vectors, np.ones(N, dtype=bool))
    down, field = predicted_vectors(rows, q, np.tile(named, (N, 1)), 0)
    assert np.isfinite(down[:, 0]).sum() == N - round(AHEAD_S * 100.0)
    level = np.arctan2(np.hypot(*down.T[:2]), down[:, 2])
    return [np.degrees(np.sqrt(np.nanmean(e**2))) for e in (level, heading_errors(field))]


@pytest.mark.parametrize("angle_deg", [2.0, 10.0, 40.0])
def test_the_truth_foretells_its_vectors_and_a_tilted_estimate_is_off_by_its_tilt(angle_deg):
    """Up to what 100 Hz integration misses of the turn in half a second."""
    assert max(foretold_errors()) < 0.6
    tilted = multiply(exp(np.radians([[angle_deg, 0.0, 0.0]])), FLOWN.q_ned_frd)  # seen from NED
    assert foretold_errors(tilted)[0] == pytest.approx(angle_deg, rel=0.02)


@pytest.mark.parametrize("bias_rad_s", [(0.2, 0.0, 0.0), (0.0, -0.2, 0.0), (0.12, 0.1, -0.15)])
def test_a_bias_that_is_not_named_shows_by_half_a_second_of_it(bias_rad_s):
    assert max(foretold_errors(bias=bias_rad_s, named=bias_rad_s)) < 0.6
    most = np.degrees(np.linalg.norm(bias_rad_s) * AHEAD_S)
    assert 1.7 < foretold_errors(bias=bias_rad_s)[0] <= most
