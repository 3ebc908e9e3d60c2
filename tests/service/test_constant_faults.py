"""What is wrong from the first sample on, and an axis of the gyroscope that steps."""

import pytest

from tests.truth.faults import HEALTHY, Fault
from tests.truth.run import Case, judge

LASTING_S = 3.0
ABSENT = Fault("magnetometer absent", begin_s=0.0)
TURNED = [Fault("magnetometer turned", 0, angle_deg, begin_s=0.0) for angle_deg in (25, 90, 180)]
IRON = Fault("magnetometer offset", 0, -0.3, begin_s=0.0)


@pytest.mark.parametrize("beside", ["", "offsets"])
@pytest.mark.parametrize("rate_hz", [50.0, 4.0])
@pytest.mark.parametrize("motion", ["circle", "slalom 12", "aerobatics"])
@pytest.mark.parametrize("fault", [*TURNED, IRON], ids=str)
def test_a_wrong_compass_does_not_move_the_tilt(motion, fault, rate_hz, beside):
    """With or without a declaration; no wrong heading has a small sigma."""
    without = judge(Case(motion, ABSENT, rate_hz=rate_hz, beside=beside, seed=5))
    found = judge(Case(motion, fault, rate_hz=rate_hz, beside=beside, seed=5))
    assert found.inclination.rms_deg < 1.5 * without.inclination.rms_deg
    assert found.wrong_and_sure_s <= LASTING_S


@pytest.mark.parametrize("motion", ["still", "hover", "coasting turn"])
@pytest.mark.parametrize("fault", [*TURNED, IRON], ids=str)
def test_a_vehicle_that_hardly_moves_is_not_sure_of_a_wrong_heading(motion, fault):
    for beside in ("", "offsets"):
        assert judge(Case(motion, fault, beside=beside, seed=5)).wrong_and_sure_s <= LASTING_S


@pytest.mark.parametrize("motion", ["circle", "aerobatics"])
def test_a_compass_that_is_left_out_is_named_and_the_attitude_is_not(motion):
    warnings = judge(Case(motion, TURNED[1], beside="offsets", seed=5)).warnings
    assert "field_impossible" in warnings
    assert "sigma_too_small" not in warnings


def test_velocity_shows_no_heading_where_it_is_noise():
    """A copter that shakes in its place, without a compass: no heading rather than any."""
    for seed in range(4):
        found = judge(Case("hover", ABSENT, seed=seed))
        assert not found.heading.under_sigma < 0.5


@pytest.mark.parametrize("motion", ["hover", "gentle tilts"])
def test_one_mad_sample_turns_nothing(motion):
    """2.5 g for one sample, as at a motor's start; within what another seed's noise does."""
    knock = Fault("accelerometer knock", 0, 25.0, begin_s=12.0)
    for seed in range(3):
        found = judge(Case(motion, knock, beside="offsets", seed=seed))
        assert found.heading.beyond_three < 0.05
        assert found.inclination.beyond_three < 0.05


def test_a_compass_that_velocity_confirms_is_as_good_as_one_declared_calibrated():
    unknown, declared = (judge(Case("climb and turn", beside=b, seed=5)) for b in ("", "offsets"))
    assert unknown.heading.rms_deg < 1.2 * declared.heading.rms_deg
    assert unknown.heading.sigma_deg < 1.5 * declared.heading.sigma_deg


def test_a_poor_gyroscope_that_was_learnt_at_rest_is_not_forgotten_at_take_off():
    """4 deg/s from the first sample on, without velocity."""
    offset = Fault("gyroscope offset", 0, 0.07, begin_s=0.0)
    found = judge(Case("gentle tilts", offset, False, beside="offsets", seed=9))
    assert found.inclination.rms_deg < 2.0


# An axis of the gyroscope at fault, at 10 Hz, so that a case takes a second

WORDS = [f"gyroscope_{axis}_contradicts" for axis in "xyz"]
STEPPED = Fault("gyroscope offset", 0, 0.3)


def words_of(verdict):
    return {word: at for word, at in verdict.warnings.items() if word in WORDS}


@pytest.mark.parametrize("has_velocity", [True, False])
@pytest.mark.parametrize("axis", range(3))
def test_a_stepped_axis_is_named_within_four_seconds(axis, has_velocity):
    """A status comes each second; other axes may be named as well."""
    fault = Fault("gyroscope offset", axis, 0.3)
    verdict = judge(Case("gentle tilts", fault, has_velocity, 10.0, seed=3))
    assert 40.0 < words_of(verdict)[WORDS[axis]] < 44.5
    assert verdict.wrong_and_sure_s < 2.0


@pytest.mark.parametrize(
    ("motion", "fault"),
    [
        ("vigorous tilts", HEALTHY),
        ("slalom 20", HEALTHY),
        ("gentle tilts", Fault("accelerometer offset", 0, 3.0, end_s=60.0)),
        ("gentle tilts", Fault("magnetometer turned", 0, 119.0, begin_s=0.0)),
        ("vigorous tilts", Fault("magnetometer turned", 0, 25.0, begin_s=0.0)),
        ("gentle tilts", Fault("magnetometer frozen")),
        ("slalom 30", Fault("magnetometer frozen", begin_s=26.0, end_s=48.0)),
        ("slalom 20", Fault("magnetometer offset", 1, 0.27)),
        ("hover", Fault("magnetometer offset", 0, 0.335)),
    ],
)
def test_a_right_gyroscope_is_not_contradicted(motion, fault):
    assert words_of(judge(Case(motion, fault, False, 10.0, seed=3))) == {}


@pytest.mark.parametrize("beside", ["imu2", "attitude"])
def test_what_the_stream_has_beside_a_stepped_axis_is_used(beside):
    alone = judge(Case("gentle tilts", STEPPED, False, 10.0, seed=3))
    helped = judge(Case("gentle tilts", STEPPED, False, 10.0, beside, seed=3))
    assert alone.inclination.rms_deg > 17.0
    assert helped.inclination.rms_deg < 4.6
    assert helped.heading.rms_deg < 8.4
