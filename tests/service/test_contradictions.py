"""An axis of the gyroscope at fault: what the status reports, and what is used in its place.

At 10 Hz, so that a case takes a second.
"""

import pytest

from tests.truth.faults import HEALTHY, Fault
from tests.truth.run import Case, judge

WORDS = [f"gyroscope_{axis}_contradicts" for axis in "xyz"]
STEPPED = Fault("gyroscope offset", 0, 0.3)


def words_of(verdict):
    return {word: at for word, at in verdict.warnings.items() if word in WORDS}


@pytest.mark.parametrize("has_velocity", [True, False])
@pytest.mark.parametrize("axis", range(3))
def test_a_stepped_axis_is_named_within_four_seconds(axis, has_velocity):
    """A status comes each second. Of x, y, z after 2, 2 and 4 s; others may be named as well."""
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
    """Alone the inclination is 22 deg off (RMS of the whole flight); beside an IMU 3.5, the heading
    3.8, beside ATTITUDE 3.8 and 7.0.
    """
    alone = judge(Case("gentle tilts", STEPPED, False, 10.0, seed=3))
    helped = judge(Case("gentle tilts", STEPPED, False, 10.0, beside, seed=3))
    assert alone.inclination.rms_deg > 17.0
    assert helped.inclination.rms_deg < 4.6
    assert helped.heading.rms_deg < 8.4
