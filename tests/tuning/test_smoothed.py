"""A flight's smoothed attitude as what it is tuned by."""

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.profile import load_profile
from fuzzbee.tune.read_flight import read_flight
from tests.fuzzbee.recording import DATA, SLOW
from tuning.flight import sure_flight
from tuning.flight_cost import measure, possible_truths

IMU, SUBMARINE = load_profile("imu"), DATA / "sub_bluerov.tlog"


@pytest.fixture(scope="module")
def flown():
    return read_flight(SLOW, IMU)


def test_truths_lie_around_a_reference_as_its_sigmas_say():
    rng = np.random.default_rng(5)
    q = rng.normal(size=(200, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    sigma_rad = np.tile([0.02, 0.05], (200, 1))
    truths = list(possible_truths(q, sigma_rad))
    errors = np.concatenate([batch_angle_errors(q, truth) for truth in truths])
    # means of eighths of a distribution; its tails are cut a little
    assert np.mean(errors[:, 1] <= 0.05) == pytest.approx(0.68, abs=0.07)
    assert np.mean(errors[:, 2] <= 0.02) == pytest.approx(0.68, abs=0.07)
    assert rms(errors[:, 1]) == pytest.approx(0.05 / 0.994, rel=0.1)
    assert rms(errors[:, 2]) == pytest.approx(0.02 * 2**0.5 / 1.51, rel=0.1)
    assert np.array_equal(next(possible_truths(q, None)), q)


def test_the_whole_flight_knows_better_and_how_well(flown):
    smooth = sure_flight(flown, IMU, is_wanted=False)
    assert smooth.reference == "smooth"
    known = smooth.known & smooth.headed
    assert known.mean() > 0.8
    errors = batch_angle_errors(smooth.truth, flown.truth)[known]
    by_truth = measure(IMU, flown)
    assert np.degrees(rms(errors[:, 2])) < 0.8 * by_truth.inclination.rms_deg
    by_smooth = measure(IMU, smooth)
    # without its sigma the reference, made of the same samples, is far too near
    sure = measure(IMU, smooth._replace(truth_sigma_rad=None))
    assert sure.inclination.coverage > 0.95
    assert 0.5 < by_smooth.inclination.coverage < 0.8
    assert by_smooth.inclination.rms_deg > 1.5 * sure.inclination.rms_deg
    # where the base profile reports no heading there is none
    reported = np.arange(len(flown.headed)) < 100
    part_headed = sure_flight(flown._replace(headed=reported), IMU, is_wanted=False)
    assert part_headed.reference == "smooth"
    assert not part_headed.headed[100:].any()


def test_what_is_not_sure_is_no_reference():
    """A submarine at 2 Hz, whose heading the whole log knows to more than 5 deg."""
    flight = read_flight(SUBMARINE, IMU)
    assert flight.reference == "autopilot"
    assert sure_flight(flight, IMU, is_wanted=False) is flight
    with pytest.raises(InputError, match=r"--reference smooth: .* in 100 and 0 % only") as error:
        read_flight(SUBMARINE, IMU, "smooth")
    assert "\n" not in str(error.value)


def test_the_best_reference_is_taken_or_the_one_that_is_wanted():
    for wanted in ("smooth", "autopilot"):
        assert read_flight(SLOW, IMU, wanted).reference == wanted
    with pytest.raises(InputError, match="no reference 'sim'"):
        read_flight(SUBMARINE, IMU, "sim")
