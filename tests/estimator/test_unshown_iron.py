"""A compass that nobody has calibrated: its sigma of 45 deg ends as turns show its iron."""

import numpy as np
import pytest

from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import chained, conjugate, exp, rotate
from estimator.live.iron import largest_eigenvalue
from estimator.profile import load_profile
from estimator.types import ImuSample

RATE_HZ, ROWS = 50.0, 1500
IRON_GAUSS = (0.1, -0.08, 0.08)  # where the horizontal field has 0.22
HEADING = 1


def in_hand(turning):
    """Readings (N, 3) of a body that is turned about all axes, and its attitudes."""
    t = np.arange(ROWS) / RATE_HZ
    rate = np.stack([np.sin(0.9 * t), np.sin(0.63 * t + 1.0), np.sin(0.77 * t + 2.0)], axis=-1)
    before = np.concatenate([rate[:1], rate[:-1]])
    q = chained(exp(0.5 * turning * (before + rate) / RATE_HZ))
    force = rotate(conjugate(q), np.tile([0.0, 0.0, -9.81], (ROWS, 1)))
    field = rotate(conjugate(q), np.tile([0.22, 0.0, 0.42], (ROWS, 1)))
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
