"""What is published of an estimate: its heading by place, the heading's sigma, iron in it."""

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.estimator import Estimator
from estimator.geometry import rotations
from estimator.geometry.earth import field_at
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import exp, multiply, rotate_inverse
from estimator.live.situation import largest_eigenvalue
from estimator.profile import load_profile
from estimator.types import ImuSample
from fuzzbee import Estimator as ArrayEstimator
from tests.flight import HEADING, Flight, errors_deg, flown
from tests.vocabulary import assert_attitude_close


def test_another_place_turns_the_heading_by_the_difference_of_the_declinations():
    """About down, of a vehicle that is tilted; the first place turns it by all of it."""
    estimator = Estimator(load_profile("imu"))
    q = exp((0.4, -0.3, 1.0))
    force, field = rotate_inverse(q, (0.0, 0.0, -9.8)), rotate_inverse(q, (0.2, 0.0, 0.42))
    for k in range(50):
        estimator.update(ImuSample(10_000 * k, (0.0, 0.0, 0.0), force, field, True))
    magnetic = estimator.attitude(490_000).q_ned_frd
    assert_attitude_close(magnetic, q, 0.01)
    for place in ((47.4, 8.5), (60.0, -140.0)):
        for _ in range(2):
            estimator.set_position(*place, 0.0, 1_735_689_600_000_000)
        declination_rad = field_at(*place, 0.0, 1_735_689_600_000_000).declination_rad
        turned = multiply(exp((0.0, 0.0, declination_rad)), magnetic)
        assert_attitude_close(estimator.attitude(490_000).q_ned_frd, turned, 1e-6)
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
    """A body with iron that is turned about all axes."""
    t = np.arange(ROWS) / RATE_HZ
    rate = np.stack([np.sin(0.9 * t), np.sin(0.63 * t + 1.0), np.sin(0.77 * t + 2.0)], axis=-1)
    before = np.concatenate([rate[:1], rate[:-1]])
    q = rotations.chained(rotations.exp(0.5 * turning * (before + rate) / RATE_HZ))
    force = rotations.rotate_inverse(q, (0.0, 0.0, -9.81))
    field = rotations.rotate_inverse(q, (0.22, 0.0, 0.42)) + IRON_GAUSS
    readings = np.stack([turning * rate, force, field], axis=1).tolist()
    samples = [ImuSample(20_000 * k, *map(tuple, v), True) for k, v in enumerate(readings)]
    return Flight(samples, [], q)


def taken(one, flight):
    """Errors and sigmas of the heading (N,), deg."""
    attitudes = flown(one, flight)
    sigmas = np.degrees([each.sigma_heading_rad for each in attitudes])
    return errors_deg(flight, attitudes)[:, HEADING], sigmas


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
