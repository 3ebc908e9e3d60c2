import msgspec
import pytest

from fuzzbee.trust import Level, heading_text, plus_minus, trust
from service.alarms import Alarm
from service.health import State
from service.records import StatusRecord
from tests.service.records import record

STATUS = StatusRecord("running", "RAW_IMU", 50.0, 0.1, {}, 0, 0, 1)


def relative(**kwargs):
    return msgspec.structs.replace(record(**kwargs), heading_reference="none")


def changed(**kwargs):
    return msgspec.structs.replace(STATUS, **kwargs)


@pytest.mark.parametrize(
    ("sigma_deg", "horizon", "heading", "overall"),
    [
        ((0.5, 2.0), Level.GOOD, Level.GOOD, Level.GOOD),
        ((2.99, 9.99), Level.GOOD, Level.GOOD, Level.GOOD),
        ((3.1, 2.0), Level.CARE, Level.GOOD, Level.CARE),
        ((10.1, 2.0), Level.BAD, Level.GOOD, Level.BAD),
        ((0.5, 11.0), Level.GOOD, Level.CARE, Level.CARE),
        ((0.5, 45.0), Level.GOOD, Level.BAD, Level.CARE),  # the horizon is as good as ever
        ((0.5, 180.0), Level.GOOD, Level.BAD, Level.CARE),
    ],
)
def test_trust_follows_sigma(sigma_deg, horizon, heading, overall):
    judged = trust(State.RUNNING, record(sigma_deg=sigma_deg))
    assert (judged.horizon, judged.heading, judged.overall) == (horizon, heading, overall)
    assert bool(judged.caveats) == (overall is not Level.GOOD)


def test_a_heading_that_refers_to_nothing_is_an_alarm_however_small_its_sigma():
    judged = trust(State.RUNNING, relative(sigma_deg=(0.5, 1.0)))
    assert judged.heading is Level.BAD
    assert judged.overall is Level.CARE
    assert judged.caveats[0].text == "no north"


@pytest.mark.parametrize("state", [State.WAITING, State.ALIGNING, State.LOST])
def test_where_there_is_no_valid_attitude_nothing_is_trusted(state):
    for attitude in (None, record()):  # a stale one changes nothing
        judged = trust(state, attitude)
        assert judged.overall is judged.horizon is judged.heading is Level.NONE
        assert judged.word == "no attitude"
        assert judged.caveats


def test_an_extrapolated_attitude_calls_for_care():
    judged = trust(State.DEGRADED, msgspec.structs.replace(record(), age_ms=1700.0))
    assert judged.overall is Level.CARE
    assert judged.caveats[0].text == "IMU silent 1.7 s"


@pytest.mark.parametrize("word", [*Alarm])
def test_a_warning_counts_whatever_sigma_says(word):
    """Sigma knows nothing of what contradicts it; a foreign field alone spares the horizon.

    Where the autopilot's attitude differs, ours may be the one that is right.
    """
    judged = trust(State.RUNNING, record(sigma_deg=(0.1, 0.1)), changed(warnings=(word.value,)))
    mild = {Alarm.FIELD_IMPOSSIBLE: Level.GOOD, Alarm.AUTOPILOT_DIFFERS: Level.CARE}
    horizon = mild.get(word, Level.BAD)
    assert judged.horizon is horizon
    assert judged.heading is (Level.CARE if word is Alarm.AUTOPILOT_DIFFERS else Level.BAD)
    assert judged.overall is max(Level.CARE, horizon)
    assert judged.caveats[0].text == word.value.replace("_", " ")


def test_a_warning_of_another_version_is_counted_and_its_words_are_not_shown():
    judged = trust(State.RUNNING, record(), changed(warnings=("\x1b[31m[bold]",)))
    assert judged.overall is Level.CARE
    assert [caveat.text for caveat in judged.caveats] == ["1 unknown warnings"]


@pytest.mark.parametrize(
    ("after", "text", "level"),
    [
        (changed(overloaded=True, shed=40), "overloaded, 40 left out", Level.GOOD),
        (changed(overruns=30), "this computer is busy, 30 late ticks", Level.GOOD),
        (changed(dropped=30), "this computer is busy, 30 records lost", Level.GOOD),
        (changed(rejected={"gap": 11}), "11 refused", Level.CARE),
    ],
)
def test_what_the_service_loses_now_is_named_and_only_refused_samples_call_for_care(
    after, text, level
):
    judged = trust(State.RUNNING, record(), after, STATUS)
    assert judged.overall is level
    assert [caveat.text for caveat in judged.caveats] == [text]
    if not after.overloaded:  # a state, not a count
        assert trust(State.RUNNING, record(), after, after).overall is Level.GOOD


def test_a_few_losses_are_no_alarm():
    after = changed(overruns=5, dropped=5, rejected={"gap": 10})
    assert trust(State.RUNNING, record(), after, STATUS).overall is Level.GOOD


def test_the_worst_alarm_comes_first():
    judged = trust(
        State.RUNNING, relative(sigma_deg=(20.0, 45.0)), changed(overloaded=True), STATUS
    )
    levels = [caveat.level for caveat in judged.caveats]
    assert levels == sorted(levels, reverse=True)
    assert judged.caveats[0].text == "horizon ±20°"


@pytest.mark.parametrize(
    ("sigma_deg", "text"), [(0.84, "±0.8°"), (9.96, "±10.0°"), (14.4, "±14°"), (180.0, "unknown")]
)
def test_sigma_has_as_many_digits_as_it_deserves(sigma_deg, text):
    assert plus_minus(sigma_deg) == text


@pytest.mark.parametrize(("yaw_deg", "text"), [(359.6, "000°"), (359.4, "359°"), (0.4, "000°")])
def test_north_is_zero_from_either_side(yaw_deg, text):
    attitude = msgspec.structs.replace(record(), euler_deg=(0.0, 0.0, yaw_deg))
    assert heading_text(attitude) == text
