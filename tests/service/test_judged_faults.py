"""Faults judged by the truth: how many are wrong and sure of it (see ``benchmarks/truth.py``)."""

from itertools import product
from math import isclose

import numpy as np
import pytest

from tests.truth.faults import HEALTHY, KINDS, Fault, Place, earth_field, impair, sense
from tests.truth.motions import MOTIONS, Draw
from tests.truth.run import Case, judge

LASTING_S = 3.0
ABSENT = Fault("magnetometer absent", begin_s=0.0)
TURNED = [Fault("magnetometer turned", 0, angle_deg, begin_s=0.0) for angle_deg in (25, 90, 180)]
IRON = Fault("magnetometer offset", 0, -0.3, begin_s=0.0)
FROZEN = Fault("magnetometer frozen")
POOR = Fault("gyroscope offset", 0, 0.07, begin_s=0.0)


@pytest.mark.parametrize("beside", ["", "offsets"])
@pytest.mark.parametrize("rate_hz", [50.0, 4.0])
@pytest.mark.parametrize("motion", ["circle", "slalom 12", "aerobatics", "started banking"])
@pytest.mark.parametrize("fault", [*TURNED, IRON], ids=str)
def test_a_wrong_compass_does_not_move_the_tilt(motion, fault, rate_hz, beside):
    """With or without a declaration; no wrong heading has a small sigma."""
    without = judge(Case(motion, ABSENT, rate_hz=rate_hz, beside=beside, seed=5))
    found = judge(Case(motion, fault, rate_hz=rate_hz, beside=beside, seed=5))
    assert found.inclination.rms_deg < 1.5 * without.inclination.rms_deg
    assert found.wrong_and_sure_s <= LASTING_S


@pytest.mark.parametrize(
    ("motion", "rate_hz"),
    [("gentle tilts", 50.0), ("gentle tilts", 10.0), ("aerobatics", 50.0), ("hand", 50.0)],
)
def test_a_compass_that_turns_in_flight_is_read_as_turned(motion, rate_hz):
    """The aided attitude goes on with the heading that gyroscope and velocity bear out."""
    turned = Fault("magnetometer turned", 0, 60.0, begin_s=40.0)
    without = judge(Case(motion, ABSENT, rate_hz=rate_hz, seed=5))
    found = judge(Case(motion, turned, rate_hz=rate_hz, seed=5))
    assert found.inclination.rms_deg < 1.2 * without.inclination.rms_deg
    assert found.heading.rms_deg < 5.0


STEPPED_HALF = [Fault("gyroscope offset", axis, 0.5) for axis in (0, 1)]


@pytest.mark.parametrize(
    ("angle", "case", "rms_deg", "rel"),
    [
        # a shaken compass that is found turned shows no unsensed turn: what is usual is learnt anew
        *(("inclination", Case("vigorous tilts", fault), 0.6, 0.2) for fault in TURNED[1:]),
        # nor does a magnet beside a hover, whose field turns against the force
        ("heading", Case("hover", Fault("magnetometer offset", 1, 0.2, end_s=60.0)), 2.15, 0.2),
        # by chance the force goes along with a field that contradicts an axis for a moment
        ("inclination", Case("hand", TURNED[2]), 0.76, 0.3),
        # the force takes back what a turned compass has done to the tilt: it is not wrong
        ("inclination", Case("coasting turn", TURNED[2]), 1.14, 0.3),
        ("inclination", Case("climb and turn", IRON), 0.69, 0.3),
        ("inclination", Case("vigorous tilts", FROZEN, rate_hz=4.0), 1.15, 0.3),
    ],
    ids=str,
)
def test_what_a_wrong_field_moves(angle, case, rms_deg, rel):
    assert getattr(judge(case), angle).rms_deg == pytest.approx(rms_deg, rel=rel)


@pytest.mark.parametrize(
    ("angle", "case", "most_deg"),
    [
        # velocity and field together are no attitude of theirs, but behind a hole
        *(
            ("inclination", Case(motion, Fault("velocity turned", 0, 90.0)), 2.0)
            for motion in ("slalom 12", "slalom 20", "circle")
        ),
        # velocities that turn the attitude are no evidence against the compass
        ("heading", Case("hand", Fault("velocity turned", 0, 90.0), seed=3), 28.0),
        # a poor gyroscope that was learnt at rest is not forgotten at take-off
        ("inclination", Case("gentle tilts", POOR, False, beside="offsets", seed=9), 2.0),
        # other rates stand in before a bias is tracked; the error of a stuck axis is no bias
        ("inclination", Case("hand", Fault("gyroscope stuck", 2), beside="attitude"), 3.0),
        # gyroscope and field bear the attitude out against an accelerometer that steps
        *(
            (angle, Case(motion, Fault("accelerometer offset", 0, 3.0, end_s=60.0)), 2.5)
            for angle, motion in product(("inclination", "heading"), ("gentle tilts", "aerobatics"))
        ),
        # field and force turn together in the frame of an axis that errs: no unsensed turn
        ("heading", Case("hover", STEPPED_HALF[0]), 5.0),
        # where velocity shows no heading, the turn by an error before it is found is a tilt
        *(
            ("heading", Case(motion, fault), 3.0)
            for motion, fault in product(("still", "coasting turn"), STEPPED_HALF)
        ),
    ],
    ids=str,
)
def test_what_an_error_of_another_sensor_leaves_alone(angle, case, most_deg):
    assert getattr(judge(case), angle).rms_deg < most_deg


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
        ("gentle tilts", FROZEN),
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


@pytest.mark.parametrize(
    ("motion", "fault", "most_deg"),
    [
        ("hover", Fault("gyroscope offset", 0, 0.1), 6.0),
        ("hover", Fault("gyroscope offset", 1, -0.1), 6.0),
        ("gentle tilts", Fault("gyroscope offset", 1, 0.5), 6.0),
        ("slalom 20", Fault("gyroscope offset", 0, 0.5), 6.0),
        ("accelerate and brake", Fault("gyroscope offset", 0, 0.5), 6.0),  # it hardly turns before
        ("accelerate and brake", Fault("gyroscope offset", 1, 0.1), 6.0),
        ("slalom 30", Fault("gyroscope stuck", 0), 6.0),
        ("hand", Fault("gyroscope stuck", 0), 15.0),
        ("vigorous tilts", Fault("gyroscope stuck", 1), 10.0),
        ("aerobatics", Fault("gyroscope saturated", 0, 0.5), 10.0),
    ],
)
def test_velocity_holds_the_tilt_beside_a_gyroscope_that_errs(motion, fault, most_deg):
    """An axis that it contradicts, too, is tracked as a bias; otherwise 15 to 84 deg."""
    found = judge(Case(motion, fault))
    assert found.inclination.rms_deg < most_deg
    assert found.inclination.beyond_three < 0.05
    assert found.wrong_and_sure_s < 2.0


def test_a_gyroscope_that_is_right_again_is_believed_again():
    offset = Fault("gyroscope offset", 0, 0.3, begin_s=40.0, end_s=45.0)
    found = judge(Case("gentle tilts", offset))
    assert found.inclination.rms_deg < 4.0
    assert found.inclination.sigma_deg < 2.5  # 4.1 while it errs


SLOW_MOTIONS = ("still", "slalom 30", "accelerate and brake", "coasting turn", "climb and turn")
FAULTS = (
    HEALTHY,
    Fault("gyroscope stuck", 1),
    Fault("gyroscope offset", 2, 0.5),
    Fault("accelerometer offset", 0, 3.0, end_s=60.0),
    Fault("accelerometer growing", 1, 0.3, end_s=60.0),
    Fault("clock pace", 0, 1e-3),
)
CASES = (
    *(Case(m, f, v, 4.0) for m, f, v in product(SLOW_MOTIONS, FAULTS, (True, False))),
    *(Case(m, f, False) for m, f in product(("still", "slalom 30"), (HEALTHY, FAULTS[3]))),
    Case("climb and turn", FAULTS[5]),
)
# Of 65, as measured; an improvement lowers it here.
WRONG_AND_SURE = 1


def test_as_many_cases_are_wrong_and_sure_as_were_measured():
    """+-20 %: the motions' figures differ a little from one machine's mathematics to another's."""
    verdicts = {str(case): judge(case) for case in CASES}
    lasting = [name for name, v in verdicts.items() if v.wrong_and_sure_s > LASTING_S]
    assert isclose(len(lasting), WRONG_AND_SURE, rel_tol=0.2), lasting
    assert all(v.running > 0.9 for name, v in verdicts.items() if "clock" not in name)
    assert all(v.flat_s >= v.wrong_and_sure_s for v in verdicts.values())


@pytest.mark.parametrize("rate_hz", [4.0, 50.0])
def test_an_accelerometer_that_contradicts_field_and_velocity_is_named(rate_hz):
    """Within 13 s for 3 m/s^2; nothing is reported for a gyroscope's 6 deg/s or without a fault."""
    wrong = Fault("accelerometer offset", 0, 3.0, end_s=60.0)
    warnings = judge(Case("still", wrong, rate_hz=rate_hz, beside="offsets")).warnings
    assert wrong.begin_s < warnings["accelerometer_contradicts"] < wrong.begin_s + 13.0
    for fault in (HEALTHY, Fault("gyroscope offset", 0, 0.1)):
        verdict = judge(Case("hover", fault, rate_hz=50.0))
        assert "accelerometer_contradicts" not in verdict.warnings


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_changes_its_own_readings_from_its_beginning_on(kind):
    field = earth_field(Place())
    healthy = sense(MOTIONS["hand"](Draw(1)), 25.0, field, seed=1)
    fault = Fault(kind, 1, 0.5, begin_s=30.0, end_s=50.0)
    broken = impair(healthy, fault, seed=1)
    sensors = ("gyroscope", "accelerometer", "magnetometer", "velocity", "clock")
    fields = ("gyr_rad_s", "acc_m_s2", "mag_gauss", "velocity_m_s", "stamp_s")
    first = fields[sensors.index(kind.split()[0])]
    for name in healthy._fields:
        changed = np.atleast_2d((getattr(broken, name) != getattr(healthy, name)).T).any(axis=0)
        before, after = changed[healthy.time_s < 30.0], changed[healthy.time_s >= 30.0]
        assert not before.any()
        assert after.any() == (name == first or (kind, name) == ("clock pace", "boot_s"))
