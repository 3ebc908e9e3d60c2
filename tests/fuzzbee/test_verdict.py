"""How far to rely on an attitude: one judgement for all views."""

import msgspec
import pytest

from fuzzbee.verdict import Level, heading_text, other_imus, plus_minus, verdict_of
from service.alarms import Alarm
from service.records import ImuDifference, State
from tests.service.records import record, status

STATUS = status(imu_rate_hz=50.0)
GOOD, CARE, BAD, NONE = Level


def judged(sigma_deg=(0.5, 2.0), state=State.RUNNING, changes=None, **status):
    """With ``changes`` of the attitude, and a status that is no more like the one before."""
    attitude = msgspec.structs.replace(record(sigma_deg=sigma_deg), **(changes or {}))
    return verdict_of(state, attitude, msgspec.structs.replace(STATUS, **status), STATUS)


def texts(judgement):
    return [caveat.text for caveat in judgement.caveats]


@pytest.mark.parametrize(
    ("sigma_deg", "levels"),
    [
        ((2.99, 9.99), (GOOD, GOOD, GOOD)),
        ((3.1, 2.0), (CARE, GOOD, CARE)),
        ((10.1, 2.0), (BAD, GOOD, BAD)),
        ((0.5, 11.0), (GOOD, CARE, CARE)),
        ((0.5, 45.0), (GOOD, BAD, CARE)),  # the horizon is as good as ever
    ],
)
def test_the_verdict_follows_sigma(sigma_deg, levels):
    found = judged(sigma_deg)
    assert (found.horizon, found.heading, found.overall) == levels
    assert bool(found.caveats) == (found.overall is not GOOD)


@pytest.mark.parametrize("word", [*Alarm])
def test_a_warning_counts_whatever_sigma_is(word):
    """A foreign field alone spares the horizon; where the autopilot differs, ours may be right."""
    found = judged((0.1, 0.1), warnings=(word.value,))
    mild = {Alarm.FIELD_IMPOSSIBLE: GOOD, Alarm.AUTOPILOT_DIFFERS: CARE}
    assert found.horizon is mild.get(word, BAD)
    assert found.heading is (CARE if word is Alarm.AUTOPILOT_DIFFERS else BAD)
    assert found.overall is max(CARE, found.horizon)
    assert texts(found) == [word.value.replace("_", " ")]
    assert (found.horizon_text == "unsure") == (found.horizon is BAD)
    assert (found.heading_text == "unsure") == (found.heading is BAD)


GYROSCOPES = ("gyroscope_x_contradicts", "gyroscope_z_contradicts")


@pytest.mark.parametrize(
    ("given", "text", "level"),
    [
        ({"overloaded": True, "shed": 40}, "overloaded, 40 left out", GOOD),
        ({"overruns": 30}, "this computer is busy, 30 late ticks", GOOD),
        ({"dropped": 30}, "this computer is busy, 30 records lost", GOOD),
        ({"rejected": {"gap": 11}}, "11 refused", CARE),
        ({"warnings": ("\x1b[31m[bold]",)}, "1 unknown warnings", CARE),  # of another version
        ({"warnings": GYROSCOPES}, "gyroscope x, z contradict", BAD),
        ({"changes": {"heading_reference": "none"}}, "no north", CARE),
        ({"changes": {"age_ms": 1700.0}, "state": State.DEGRADED}, "IMU silent 1.7 s", CARE),
        ({"changes": {"euler_deg": (-120.0, 0.0, 0.0)}}, "upside down", GOOD),
    ],
)
def test_each_reason_has_its_words(given, text, level):
    found = judged(**given)
    assert found.overall is level
    assert found.heading is BAD or text != "no north"  # however small its sigma
    assert texts(found) == [text]


def test_a_few_losses_or_those_of_before_are_no_reason():
    assert texts(judged(overruns=5, dropped=5, rejected={"gap": 10})) == []
    assert texts(judged(rejected={"gap": 1}, imu_rate_hz=4.0)) == []
    busy = [msgspec.structs.replace(STATUS, overloaded=True, shed=shed) for shed in (140, 100)]
    assert texts(verdict_of(State.RUNNING, record(), *busy)) == ["overloaded, 40 left out"]
    after = msgspec.structs.replace(STATUS, overruns=30)
    assert texts(verdict_of(State.RUNNING, record(), after, after)) == []


@pytest.mark.parametrize("state", [State.WAITING, State.ALIGNING, State.LOST])
def test_without_a_valid_attitude_every_level_is_none(state):
    for found in (verdict_of(state, None), judged(state=state)):  # a stale one changes nothing
        assert found[:3] == (NONE, NONE, NONE)
        assert found.word == "no attitude"
        assert found.caveats


def test_the_worst_reason_comes_first():
    found = judged((20.0, 45.0), overloaded=True, warnings=("field_impossible",))
    levels = [caveat.level for caveat in found.caveats]
    assert levels == sorted(levels, reverse=True)
    assert texts(found)[0] == "horizon ±20°"


@pytest.mark.parametrize(
    ("sigma_deg", "yaw_deg", "texts"),
    [
        (0.84, 359.6, ("±0.8°", "000°")),  # north is zero from either side
        (9.96, 359.4, ("±10.0°", "359°")),
        (14.4, 0.4, ("±14°", "000°")),
        (180.0, 45.0, ("unknown", "045°")),
    ],
)
def test_angles_have_as_many_digits_as_they_deserve(sigma_deg, yaw_deg, texts):
    attitude = msgspec.structs.replace(record(), euler_deg=(0.0, 0.0, yaw_deg))
    assert (plus_minus(sigma_deg), heading_text(attitude)) == texts


@pytest.mark.parametrize(
    ("others", "found", "level"),
    [
        ({"SCALED_IMU2": (2.9, 4.9)}, [], GOOD),
        ({"SCALED_IMU2": (3.14, 0.2)}, ["IMU 2 off by 3.1°"], CARE),
        ({"SCALED_IMU2": (3.14, 0.2), "SCALED_IMU3": (0.1, 0.2)}, ["IMU 2 off by 3.1°"], GOOD),
        ({"HIGHRES_IMU:2": (0.1, 9.0)}, ["IMU 3 off by 9.0°/s"], CARE),
        ({"HIGHRES_IMU": (7.0, 9.0)}, ["HIGHRES_IMU off by 7.0°, 9.0°/s"], CARE),
    ],
)
def test_an_imu_that_differs_is_named_and_ours_may_be_wrong_if_all_do(others, found, level):
    """Of several others one that agrees with ours shows which is wrong."""
    differences = {message: ImuDifference(*each) for message, each in others.items()}
    assert texts(judged(other_imus=differences)) == found
    assert judged(other_imus=differences).overall is level


def test_each_imu_has_a_short_name():
    messages = ("SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU:1", "IMU")
    given = dict.fromkeys(messages, ImuDifference(1.0, 1.0))
    status = msgspec.structs.replace(STATUS, imu_message="SCALED_IMU2", other_imus=given)
    assert [*other_imus(status)] == ["SCALED_IMU2", "IMU 3", "HIGHRES_IMU:1", "IMU 1"]
