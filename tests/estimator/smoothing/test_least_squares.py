"""The smoother's parts beside plain ones: sums, pieces, reversed reports, joint estimates."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.conditioning.vertical.averaging import WINDOW_S
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.rotations import about_down, chained, conjugate, exp, log, rotate
from estimator.live.rows import ROW, SIGMA, Q, report_of, report_rows_of
from estimator.profile import load_profile
from estimator.smoothing import Recorder, smooth, smooth_all
from estimator.smoothing.backward import turned_round
from estimator.smoothing.field import usable_fields
from estimator.smoothing.heading import SCALE_SIGMA, least_squares, variances
from estimator.smoothing.recording import Estimates, joined
from estimator.smoothing.windows import low_passed
from estimator.types import RateSample, VelocitySample
from tests.flight import HEADING, banked_flight, changed, flown

RNG = np.random.default_rng(5)


def test_chained_turns_are_their_products():
    turns = RNG.normal(0.0, 0.5, (137, 3))
    product, products = Rotation.identity(), []
    for turn in turns:
        product = product * Rotation.from_rotvec(turn)
        products.append(product.as_matrix())
    q = chained(exp(turns))
    made = Rotation.from_quat(q, scalar_first=True)
    assert np.allclose(made.as_matrix(), products, atol=1e-12)  # rounding
    assert np.allclose(log(exp(turns)), turns, atol=1e-12)
    vectors = RNG.normal(size=(137, 3))
    assert np.allclose(rotate(q, vectors), made.apply(vectors), atol=1e-12)


def test_the_heading_is_the_least_squares_solution_with_its_variances():
    """With the scale errors as three more unknowns of one dense system."""
    n = 40
    z, r, q = RNG.normal(size=n), RNG.uniform(0.1, 5.0, n), RNG.uniform(0.01, 1.0, n - 1)
    a = RNG.normal(0.0, 200.0, (n - 1, 3))
    steps = np.concatenate([np.diff(np.eye(n), axis=0), -a], axis=1)
    prior = np.diag(np.concatenate([1.0 / r, np.full(3, SCALE_SIGMA**-2)]))
    information = prior + steps.T @ np.diag(1.0 / q) @ steps
    known = np.concatenate([z / r, np.zeros(3)])
    x, by_scale = least_squares(z, r, q, a)
    assert np.allclose(x, np.linalg.solve(information, known)[:n], atol=1e-9)
    both = variances(r, q) + by_scale
    assert np.allclose(both, np.diag(np.linalg.inv(information))[:n], atol=1e-9)
    assert np.median(by_scale / both) > 0.1  # so that either part is seen


def test_the_low_pass_has_no_delay_and_leaves_half_at_its_cutoff():
    """That is at sqrt(2) / (2 pi tau), as of the estimator's own, there and back."""
    time_s = np.arange(0.0, 100.0, 0.25)
    slow = np.sin(0.05 * time_s)[:, None]
    quick = np.sin(8.0 * time_s)[:, None]
    passed = low_passed(slow + quick, 1.0)[40:-40]
    assert np.allclose(passed, slow[40:-40], atol=0.01)  # the quick one, 60 times smaller
    wave = np.sin(np.sqrt(2.0) / 5.0 * WINDOW_S * np.arange(2000))[:, None]
    left = low_passed(wave, 5.0)[500:1500]
    assert np.sqrt(np.mean(left**2) / np.mean(wave**2)) == pytest.approx(0.5, abs=0.01)


def smoothed(flight):
    recorder = Recorder(load_profile("imu"))
    flown(recorder, flight, reports=[])
    _, found = smooth_all(recorder)
    return found[:, np.r_[Q, SIGMA]]


def test_pieces_with_wide_margins_are_what_the_whole_is(monkeypatch):
    flight = banked_flight(seconds=40.0, rate_hz=50.0)
    whole = smoothed(flight)
    monkeypatch.setattr(smooth, "PIECE_S", 10.0)
    np.testing.assert_array_equal(smoothed(flight), whole)
    monkeypatch.setattr(smooth, "MARGIN_S", 1.0)
    assert not np.array_equal(smoothed(flight), whole)


MIRRORED_US = 10_000_000


def velocity(time_us, north_m_s):
    return VelocitySample(time_us, (north_m_s, 0.0, -1.0), True, 0.1, late_sigma_s=0.05)


def test_time_turned_round_changes_signs_and_order_and_takes_ages_off():
    velocities = [velocity(1_000_000, 3.0), velocity(2_000_000, 4.0)]
    rates = [RateSample(1_000_000 * k, (0.1 * k, 0.0, -0.2)) for k in (1, 2, 3)]
    reports = report_rows_of((0, report) for report in (*velocities, *rates))
    times_us = np.array([6_000_000, 8_100_000])
    rows = turned_round(reports, times_us, MIRRORED_US, np.full(len(reports), 0.25), late_s=1e-4)
    back = [report_of(row) for row in rows]
    assert rows[:, ROW].tolist() == [1, 1, 2, 2, 2]
    assert [report.time_us for report in back] == [
        *(7_000_000, 8_000_000, 8_250_000, 9_000_000, 9_250_000)
    ]
    assert [report for report in back if isinstance(report, RateSample)] == [
        RateSample(MIRRORED_US - r.time_us, (-r.rate_rad_s[0], -0.0, 0.2)) for r in reversed(rates)
    ]
    assert back[-1] == velocities[0]._replace(
        time_us=9_250_000, velocity_ned_m_s=(-3.0, 0.0, 1.0), late_sigma_s=1e-4
    )


ONE_RAD, OTHER_RAD = 0.03, 0.04  # together 0.05


def estimates(heading_rad, sigma_rad, is_aided):
    turns = np.array([[0.0, 0.0, heading_rad]])
    return Estimates(exp(turns), np.full((1, 2), sigma_rad), np.array([is_aided]))


@pytest.mark.parametrize(
    ("is_aided", "between_rad", "heading_rad"),
    [
        (True, 0.05, 0.024),  # independent errors: 0.03 * 0.04 / 0.05
        (True, 0.2, 0.096),  # four times further apart than their sigmas are together
        (False, 0.05, 0.0336),  # common errors: the mean, 0.64 * 0.03 + 0.36 * 0.04
        (False, 0.2, 0.096),
    ],
)
def test_sigma_knows_whether_errors_are_common_and_grows_by_what_is_between(
    is_aided, between_rad, heading_rad
):
    one, other = estimates(0.0, ONE_RAD, is_aided), estimates(between_rad, OTHER_RAD, is_aided)
    both = joined(one, other)
    inclination, heading = both.sigma_rad[0]
    assert log(both.q_ned_frd)[0, 2] == pytest.approx(between_rad * 0.36)  # by both variances
    assert heading == pytest.approx(heading_rad)
    assert inclination == pytest.approx(0.024 if is_aided else 0.0336)


RATE_HZ = 10.0


def heading_deg(attitudes, q):
    """RMS from 20 s on."""
    return np.degrees(rms(batch_angle_errors(attitudes, q)[round(20.0 * RATE_HZ) :, HEADING]))


def test_a_field_that_points_elsewhere_for_a_while_does_not_count_on_the_way_back():
    """To the east, for 40 s."""
    flight = banked_flight(seconds=160.0, rate_hz=RATE_HZ, report_hz=5.0, bank_rad=0.1)
    q = np.array(flight.truth)
    time_s = np.arange(len(q)) / RATE_HZ
    is_turned = (time_s >= 60.0) & (time_s < 100.0)
    field = rotate(q, np.array([s.mag_gauss for s in flight.samples]))
    field = rotate(about_down(np.where(is_turned, 0.7, 0.0)), field)
    mag = map(tuple, rotate(conjugate(q), field).tolist())
    flight = changed(flight, lambda sample, _: sample._replace(mag_gauss=next(mag)))
    recorder = Recorder(load_profile("imu"))
    causal = np.array([a.q_ned_frd for a in flown(recorder, flight)])
    (recording,) = recorder.recordings()
    counts = usable_fields(recording)
    assert not counts[is_turned].any()
    assert counts[~is_turned].mean() > 0.95  # all but what is less than 4 s away from it
    smoothed = heading_deg(smooth_all(recorder)[1][:, Q], q)
    assert smoothed < 0.3 * heading_deg(causal, q)
    assert smoothed < 0.4
