"""From an attitude to the record: what is not finite, and angles as people read them."""

from math import inf, nan, pi, radians

import pytest

from estimator.geometry.frames import from_euler_rad
from estimator.types import Attitude
from service.health import State
from service.records import attitude_record, euler_deg, is_finite

NUMBERS = ("error", "error_rate_1_s", "gain", "confidence_gravity", "confidence_magnetic")
VECTORS = ("q_ned_frd", "rate_rad_s", "gyro_bias_rad_s")


def attitude(**changes):
    plain = Attitude(
        time_us=7,
        q_ned_frd=from_euler_rad(radians(10.0), radians(-20.0), radians(300.0)),
        rate_rad_s=(0.1, -0.2, 0.3),
        gyro_bias_rad_s=(0.01, 0.02, -0.03),
        error=0.1,
        error_rate_1_s=-0.2,
        gain=3.0,
        confidence_gravity=1.0,
        confidence_magnetic=0.5,
        sigma_inclination_rad=0.02,
        sigma_heading_rad=0.04,
        heading_reference="true",
    )
    return plain._replace(**changes)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_any_number_that_is_not_finite_makes_no_record(bad):
    assert is_finite(attitude())
    for name in NUMBERS:
        assert not is_finite(attitude(**{name: bad})), name
    for name in VECTORS:
        whole = getattr(attitude(), name)
        for k in range(len(whole)):
            assert not is_finite(attitude(**{name: (*whole[:k], bad, *whole[k + 1 :])})), (name, k)
    assert attitude_record(attitude(gain=bad), time_unix_us=1, time_boot_us=2, sequence=3) is None


def test_numbers_keep_their_places():
    made = attitude_record(
        attitude(), time_unix_us=1, time_boot_us=2, state=State.DEGRADED, age_us=5_500, sequence=3
    )
    assert made.euler_deg == pytest.approx((10.0, -20.0, 300.0))
    assert (made.time_unix_us, made.time_boot_us, made.sequence) == (1, 2, 3)
    assert (made.state, made.age_ms) == ("degraded", 5.5)
    assert (made.error, made.error_rate, made.gain) == (0.1, -0.2, 3.0)
    assert (made.confidence.gravity, made.confidence.magnetic) == (1.0, 0.5)
    assert made.sigma_deg.inclination == pytest.approx(0.02 * 180 / pi)
    assert made.sigma_deg.heading == pytest.approx(0.04 * 180 / pi)


def test_an_unknown_sigma_is_half_a_turn_and_an_age_never_below_zero():
    made = attitude_record(
        attitude(sigma_heading_rad=inf), time_unix_us=1, time_boot_us=2, age_us=-3, sequence=0
    )
    assert made.sigma_deg.heading == 180.0
    assert made.age_ms == 0.0


@pytest.mark.parametrize("yaw_rad", [-1e-17, -6e-16, -8e-16, 0.0, pi, -pi, 2.0 * pi])
def test_yaw_is_below_360_degrees(yaw_rad):
    assert 0.0 <= euler_deg(from_euler_rad(0.0, 0.0, yaw_rad))[2] < 360.0
