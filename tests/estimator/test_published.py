"""What is published of an estimate: where it is propagated to, its sigmas, iron in them."""

from math import asin, degrees, sqrt

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.estimator import Estimator
from estimator.geometry import rotations
from estimator.geometry.earth import field_at
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import exp, multiply, rotate_inverse
from estimator.live.iron import largest_eigenvalue
from estimator.live.published import LEAST_SIGMA_RAD
from estimator.profile import load_profile
from estimator.types import ImuSample
from fuzzbee import Estimator as ArrayEstimator
from tests.flight import HEADING
from tests.paper_noise import samples_of
from tests.vocabulary import assert_attitude_close

PERIOD_US = 10_000


def samples(count, **options):
    made = samples_of(simulate(3, count, **options))
    return [sample._replace(time_us=sample.time_us + PERIOD_US) for sample in made]


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
    estimator = Estimator(load_profile("paper"))
    stream = samples(3000, noise=0.0, bias=0.0, motion="rest")
    for sample in stream:
        estimator.update(sample)
    now = estimator.attitude(stream[-1].time_us)
    assert now.error < 1e-9
    assert now.sigma_inclination_rad == LEAST_SIGMA_RAD
    # the vectors turned it round at the start, which is forgotten in 20 s and more
    assert degrees(now.sigma_heading_rad) == pytest.approx(1.65, rel=0.2)


@pytest.mark.parametrize("name", ["paper", "imu"])
def test_a_turn_given_in_ned_turns_the_attitude_in_ned(name):
    """The vehicle is neither level nor heading north: the axis is not the body's."""
    estimator = Estimator(load_profile(name))
    stream = samples(200)
    for sample in stream:
        estimator.update(sample)
    before = estimator.attitude(stream[-1].time_us).q_ned_frd
    turn = exp((0.3, -0.2, 0.5))
    estimator.turn(turn)
    after = estimator.attitude(stream[-1].time_us).q_ned_frd
    assert_attitude_close(after, multiply(turn, before), 1e-9)


def test_another_place_turns_the_heading_by_the_difference_of_the_declinations():
    """About down, of a vehicle that is tilted; the first place turns it by all of it."""
    estimator = Estimator(load_profile("imu"))
    q = exp((0.4, -0.3, 1.0))
    force, field = rotate_inverse(q, (0.0, 0.0, -9.8)), rotate_inverse(q, (0.2, 0.0, 0.42))
    for k in range(50):
        estimator.update(ImuSample((k + 1) * PERIOD_US, (0.0, 0.0, 0.0), force, field, True))
    magnetic = estimator.attitude(50 * PERIOD_US).q_ned_frd
    assert_attitude_close(magnetic, q, 0.01)
    for place in ((47.4, 8.5), (60.0, -140.0)):
        for _ in range(2):
            estimator.set_position(*place, 0.0, 1_735_689_600_000_000)
        declination_rad = field_at(*place, 0.0, 1_735_689_600_000_000).declination_rad
        turned = multiply(exp((0.0, 0.0, declination_rad)), magnetic)
        assert_attitude_close(estimator.attitude(50 * PERIOD_US).q_ned_frd, turned, 1e-6)
    assert declination_rad > 0.25


def heading_scores(motion, magnet):
    """Heading's errors and sigmas (deg) by raw vectors, which follow a magnet, from 9.5 s on."""
    recording = simulate(3, 2500, motion=motion, magnet=magnet)
    attitudes = ArrayEstimator(load_profile("paper"), rate_hz=100.0).update_batch(
        recording.gyr_rad_s, recording.acc_m_s2, recording.mag_gauss
    )
    errors = batch_angle_errors(attitudes.q_ned_frd, recording.q_ned_frd)[:, HEADING]
    return np.degrees(errors[950:]), np.degrees(attitudes.sigma_heading_rad[950:])


@pytest.mark.parametrize(
    ("motion", "worst", "sigma_there", "coverage"),
    [("paper", 54.7, 56.0, 0.98), ("rest", 79.5, 71.8, 0.70), ("turn", 177.6, 171.2, 0.88)],
)
def test_a_magnet_is_in_sigma(motion, worst, sigma_there, coverage):
    errors, sigmas = heading_scores(motion, (10.0, 20.0))
    k = np.argmax(errors)
    assert (errors[k], sigmas[k]) == pytest.approx((worst, sigma_there), rel=0.2)
    assert np.mean(errors <= sigmas) == pytest.approx(coverage, rel=0.2)


def test_without_a_magnet_sigma_is_little_wider():
    errors, sigmas = heading_scores("rest", None)
    assert np.mean(sigmas) == pytest.approx(12.0, rel=0.2)
    assert np.mean(errors <= sigmas) == 1.0


RATE_HZ, ROWS = 50.0, 1500
IRON_GAUSS = (0.1, -0.08, 0.08)  # where the horizontal field has 0.22


def in_hand(turning):
    """Readings (N, 3) of a body that is turned about all axes, and its attitudes."""
    t = np.arange(ROWS) / RATE_HZ
    rate = np.stack([np.sin(0.9 * t), np.sin(0.63 * t + 1.0), np.sin(0.77 * t + 2.0)], axis=-1)
    before = np.concatenate([rate[:1], rate[:-1]])
    q = rotations.chained(rotations.exp(0.5 * turning * (before + rate) / RATE_HZ))
    force = rotations.rotate(rotations.conjugate(q), np.tile([0.0, 0.0, -9.81], (ROWS, 1)))
    field = rotations.rotate(rotations.conjugate(q), np.tile([0.22, 0.0, 0.42], (ROWS, 1)))
    return turning * rate, force, field + IRON_GAUSS, q


def taken(one, readings):
    """Errors and sigmas of the heading (N,), deg."""
    *columns, q = readings
    attitudes = []
    for k, (gyr, acc, mag) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
        one.update(ImuSample(20_000 * k, tuple(gyr), tuple(acc), tuple(mag), True))
        attitudes.append(one.attitude(20_000 * k))
    errors = batch_angle_errors(np.array([each.q_ned_frd for each in attitudes]), q)[:, HEADING]
    return np.degrees(errors), np.degrees([each.sigma_heading_rad for each in attitudes])


@pytest.fixture
def uncalibrated():
    one = Estimator(load_profile("imu"))
    one.set_field_calibrated(False)
    return one


def test_turns_end_the_uncertainty(uncalibrated):
    errors, sigmas = taken(uncalibrated, in_hand(1.6))
    ends = int(np.argmax(sigmas < 44.0))
    assert (sigmas[50:ends] > 44.0).all()
    assert 75 < ends < 200  # at 2 s
    assert np.mean(errors[ends:] < sigmas[ends:]) > 0.68
    assert errors[-1] < sigmas[-1] < 10.0  # 0.5 and 5.8 deg, of 31 by the iron
    assert uncalibrated.compass_fault == ""


def test_without_turns_it_stays(uncalibrated):
    _, sigmas = taken(uncalibrated, in_hand(0.0))
    assert sigmas[50:] == pytest.approx(45.0)
    assert uncalibrated.compass_fault == "nobody has calibrated the compass"


def test_turns_do_not_refute_other_evidence(uncalibrated):
    """A field unlike the place's stays one, whatever its iron."""
    uncalibrated.set_position(-75.0, 40.0, 0.0, 1_700_000_000_000_000)
    taken(uncalibrated, in_hand(1.6))
    known = uncalibrated.snapshot.context.compass
    now = known._replace(unlike_us=uncalibrated.snapshot.core.time_us)
    snapshot = uncalibrated.snapshot
    uncalibrated.snapshot = snapshot._replace(context=snapshot.context._replace(compass=now))
    assert np.degrees(uncalibrated.unshown_iron_rad) == pytest.approx(45.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_eigenvalue_is_numpys(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-4, 2)
    S = A @ A.T
    found = largest_eigenvalue(tuple(np.diag(S)), (S[1, 2], S[0, 2], S[0, 1]))
    assert found == pytest.approx(np.linalg.eigvalsh(S)[-1], rel=1e-9)
    assert largest_eigenvalue((2.0, 2.0, 2.0), (0.0, 0.0, 0.0)) == 2.0  # of equal axes
