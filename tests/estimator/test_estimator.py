"""The estimator of one vehicle: what it refuses, forgets, keeps and publishes."""

import json
from math import asin, degrees, inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulation.simulated_vehicle import simulate
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, multiply
from estimator.live.published import LEAST_SIGMA_RAD, OUTPUT_HORIZON_S
from estimator.live.refusal import ACC_LIMIT_M_S2, RATE_LIMIT_RAD_S
from estimator.live.rows import OUTPUT_SIZE, Q, report_rows_of, rows_of
from estimator.profile import load_profile, merge_profile
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample
from tests.flight import calibrated
from tests.paper_noise import samples_of
from tests.vocabulary import IDENTITY, angle_rad, assert_attitude_close, floats

LEVEL = ImuSample(1_000_000, ZERO_VEC3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)


@pytest.fixture(params=["paper", "imu"])
def profile(request):
    return load_profile(request.param)


def samples(count, **options):
    return list(samples_of(simulate(3, count, **options)))


def fed(profile, stream):
    estimator = calibrated(profile)
    for sample in stream:
        assert estimator.update(sample) is None
    return estimator


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"gyr_rad_s": (nan, 0.0, 0.0)}, "not_finite"),
        ({"acc_m_s2": (0.0, inf, 0.0)}, "not_finite"),
        ({"mag_gauss": (0.0, 0.0, -inf)}, "not_finite"),
        ({"gyr_rad_s": (0.0, -RATE_LIMIT_RAD_S - 1e-9, 0.0)}, "gyroscope_out_of_range"),
        ({"acc_m_s2": (0.0, 0.0, ACC_LIMIT_M_S2 + 1e-9)}, "accelerometer_out_of_range"),
        ({"time_us": LEVEL.time_us}, "not_later"),
        ({"time_us": LEVEL.time_us - 1}, "not_later"),
    ],
)
def test_a_refused_sample_leaves_no_trace(profile, change, reason):
    estimator = fed(profile, [LEVEL])
    before = estimator.snapshot
    later = LEVEL._replace(time_us=LEVEL.time_us + 10_000)
    assert estimator.update(later._replace(**change)) == reason
    assert estimator.snapshot == before


def test_the_limits_themselves_are_let_through(profile):
    estimator = fed(profile, [LEVEL])
    hard = LEVEL._replace(
        time_us=2_000_000, gyr_rad_s=(RATE_LIMIT_RAD_S,) * 3, acc_m_s2=(-ACC_LIMIT_M_S2,) * 3
    )
    assert estimator.update(hard) is None


def test_the_first_sample_may_have_any_time_but_must_be_good(profile):
    estimator = Estimator(profile)
    assert not estimator.aligned
    assert estimator.update(LEVEL._replace(acc_m_s2=(nan, 0.0, 0.0))) == "not_finite"
    assert not estimator.aligned
    assert estimator.update(LEVEL._replace(time_us=-5)) is None
    assert estimator.aligned


def test_aligns_level_and_north_on_the_first_sample():
    estimator = fed(load_profile("imu"), [LEVEL])
    assert_attitude_close(estimator.attitude(LEVEL.time_us).q_ned_frd, IDENTITY, 1e-9)


def test_paper_profile_starts_where_the_paper_does():
    estimator = fed(load_profile("paper"), samples(1))
    # without noise 0.0003
    assert 1.0 - estimator.attitude(0).error == pytest.approx(0.0115, rel=0.2)
    # the experiment corrects at t = 0, too: gamma/2 |vex| dt, |vex| = 0.18
    bias = np.linalg.norm(estimator.attitude(0).gyro_bias_rad_s)
    assert bias == pytest.approx(0.00089, rel=0.2)


def test_replacing_the_profile_keeps_the_estimate(profile):
    stream = samples(400)
    estimator, untouched = fed(profile, stream[:200]), fed(profile, stream[:200])
    before = estimator.snapshot
    slower = merge_profile(profile, {"filter": {"rate_time_constant_s": 0.6}})
    estimator.replace_profile(slower)
    assert estimator.profile is slower
    derived = before.core.conditioning.vertical.coefficients  # of the parameters, no estimate
    now = estimator.snapshot
    memory = now.core.conditioning
    memory = memory._replace(vertical=memory.vertical._replace(coefficients=derived))
    assert now._replace(core=now.core._replace(conditioning=memory)) == before
    for sample in stream[200:]:
        estimator.update(sample)
        untouched.update(sample)
    assert estimator.snapshot != untouched.snapshot


def test_new_conditioning_parameters_count_at_once_though_the_rate_stays():
    """What follows from parameters and interval is kept between samples; not across a change."""
    stream = samples(400, motion="rest")
    quick = merge_profile(load_profile("imu"), {"conditioning": {"gravity_tau_s": 0.2}})
    changed, untouched = (fed(load_profile("imu"), stream[:200]) for _ in range(2))
    changed.replace_profile(quick)
    for sample in stream[200:210]:
        changed.update(sample)
        untouched.update(sample)
    gravity = [e.snapshot.core.conditioning.vertical.gravity for e in (changed, untouched)]
    assert gravity[0] != gravity[1]


@pytest.mark.parametrize(
    ("first", "second", "sigma_rad"), [("paper", "imu", 0.0918), ("imu", "paper", 0.675)]
)
def test_profiles_of_the_other_kind_can_be_swapped_in(first, second, sigma_rad):
    """The north of the paper lies 45 deg away: to turn there is a pull that is forgotten."""
    stream = samples(600, motion="rest")
    estimator = fed(load_profile(first), stream[:300])
    estimator.replace_profile(load_profile(second))
    for sample in stream[300:]:
        assert estimator.update(sample) is None
    after = estimator.attitude(stream[-1].time_us)
    assert after.heading_reference == ("true" if second == "paper" else "magnetic")
    assert after.sigma_heading_rad == pytest.approx(sigma_rad, rel=0.2)
    assert_attitude_close(after.q_ned_frd, after.q_ned_frd, 0.0)
    if second == "paper":
        assert (after.confidence_gravity, after.confidence_magnetic) == (1.0, 1.0)


def test_output_is_propagated_with_the_last_rate_up_to_the_horizon(profile):
    """About the axes of a body that is neither level nor heading north: q exp(w t)."""
    estimator = fed(profile, samples(200))
    at = estimator.snapshot.core.time_us
    now = estimator.attitude(at)
    for ahead_s in (0.0, 0.01, 0.5, OUTPUT_HORIZON_S):
        later = estimator.attitude(at + round(1e6 * ahead_s))
        phi = tuple(ahead_s * x for x in now.rate_rad_s)
        assert_attitude_close(later.q_ned_frd, multiply(now.q_ned_frd, exp(phi)), 1e-12)
        assert later.time_us == at + round(1e6 * ahead_s)
    elsewhere = multiply(exp(phi), now.q_ned_frd)
    assert angle_rad(later.q_ned_frd, elsewhere) > 0.02  # the order shows
    far = estimator.attitude(at + 3_600_000_000)
    assert_attitude_close(far.q_ned_frd, later.q_ned_frd, 1e-12)
    past = estimator.attitude(at - 1_000_000)  # never propagated backwards
    assert past.q_ned_frd == now.q_ned_frd


wide = st.tuples(*[st.one_of(floats(-1e300, 1e300), floats(-500.0, 500.0))] * 3)


@given(st.lists(st.tuples(st.integers(0, 10**13), wide, wide, wide, st.booleans()), max_size=6))
@settings(max_examples=150)
def test_stays_finite_whatever_arrives(stream):
    for name in ("paper", "imu"):
        estimator = fed(load_profile(name), samples(5))
        for time_us, gyr, acc, mag, has_mag in stream:
            estimator.update(ImuSample(time_us, gyr, acc, mag, has_mag))
            published = estimator.attitude(time_us)
            assert_attitude_close(published.q_ned_frd, published.q_ned_frd, 0.0)
            sigmas = published.sigma_inclination_rad, published.sigma_heading_rad
            numbers = published.error, published.error_rate_1_s, published.gain, *sigmas
            assert np.all(np.isfinite((*published.gyro_bias_rad_s, *numbers))), published
            assert 0.0 <= published.error <= 1.0
            assert 1.0 <= published.gain <= 101.0


def test_rows_of_raw_vectors_are_their_samples_one_by_one():
    """Velocities and rates between them change nothing."""
    stream, profile = samples(300), load_profile("paper")
    straight, in_rows = Estimator(profile), Estimator(profile)
    report = VelocitySample(stream[99].time_us, (9.0, 2.0, 0.0), True, 0.3)
    attitudes = []
    for k, sample in enumerate(stream):
        assert straight.update(sample) is None
        attitudes.append(straight.attitude(sample.time_us).q_ned_frd)
        if k == 99:
            straight.update_report(report)
    published = np.empty((len(stream), OUTPUT_SIZE))
    rows = rows_of(*(np.array(column) for column in zip(*stream, strict=True)))
    assert in_rows.take_all(rows, published, report_rows_of([(100, report)])) == []
    assert [tuple(q) for q in published[:, Q].tolist()] == attitudes
    assert in_rows.snapshot == straight.snapshot


@pytest.mark.parametrize("name", ["imu", "paper"])
def test_integers_are_numbers(name):
    """Samples, reports and profiles of integers give the same attitude as those of floats."""
    whole = {"reference": {"gravity": [0, 0, 1], "magnetic": [1, 0, 0]}, "filter": {"gamma": 1}}
    whole |= {"confidence": {"gravity": 5}, "membership": {"k12": 8}}
    whole |= {"conditioning": {"gravity_tau_s": 2}, "aiding": {"error_tau_s": 5}}
    found = []
    for number in (int, float):
        changed = json.loads(json.dumps(whole), parse_int=number)
        one = Estimator(merge_profile(load_profile(name), changed))
        zero, down, field = (tuple(map(number, v)) for v in ((0, 0, 0), (0, 0, -10), (1, 0, 2)))
        for k in range(12):
            assert one.update(ImuSample(10_000 * k, zero, down, field, True)) is None
            report = VelocitySample(10_000 * k, zero, True, number(1), number(0))
            assert one.update_report(report) is None
        found.append((one.attitude(120_000), one.snapshot))
    assert found[0] == found[1]


def test_sigma_of_raw_vectors_follows_the_error_of_the_last_second():
    """2 asin sqrt(mean e), the mean a low-pass of 1 s: one sample's e is mostly its noise."""
    estimator = Estimator(load_profile("paper"))
    mean, sigmas = None, []
    for sample in samples(500):
        estimator.update(sample)
        now = estimator.attitude(sample.time_us)
        share = 0.01 / (1.0 + 0.01)
        mean = now.error if mean is None else mean + share * (now.error - mean)
        assert now.sigma_inclination_rad == pytest.approx(2.0 * asin(sqrt(mean)))
        assert now.sigma_heading_rad >= now.sigma_inclination_rad
        sigmas.append(degrees(now.sigma_inclination_rad))
    # measured: 15.5 deg, and 0.014 deg from one sample to the next
    assert np.mean(sigmas[-100:]) == pytest.approx(15.5, rel=0.2)
    assert np.std(np.diff(sigmas[-100:])) == pytest.approx(0.0144, rel=0.2)


def test_no_estimate_claims_to_be_perfect():
    now = fed(load_profile("paper"), samples(3000, noise=0.0, bias=0.0, motion="rest")).attitude(0)
    assert now.error < 1e-9
    assert now.sigma_inclination_rad == LEAST_SIGMA_RAD
    # the vectors turned it round at the start, which is forgotten in 20 s and more
    assert degrees(now.sigma_heading_rad) == pytest.approx(1.65, rel=0.2)


def test_a_turn_given_in_ned_turns_the_attitude_in_ned(profile):
    """The vehicle is neither level nor heading north: the axis is not the body's."""
    estimator, turn = fed(profile, samples(200)), exp((0.3, -0.2, 0.5))
    before = estimator.attitude(0).q_ned_frd
    estimator.turn(turn)
    assert_attitude_close(estimator.attitude(0).q_ned_frd, multiply(turn, before), 1e-9)


def test_published_rate_is_free_of_the_bias():
    estimator = fed(load_profile("paper"), samples(500))
    last = samples(500)[-1]
    published = estimator.attitude(last.time_us)
    assert np.abs(published.gyro_bias_rad_s).max() == pytest.approx(0.126, rel=0.2)
    expected = np.subtract(last.gyr_rad_s, published.gyro_bias_rad_s)
    np.testing.assert_allclose(published.rate_rad_s, expected, atol=1e-15)
