"""When the autopilot's attitude and ours are reported to agree or to differ, and who is named."""

from math import atan2, cos, degrees, hypot, radians, sin

import pytest

from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import exp, multiply, rotate_inverse, scale
from estimator.types import Attitude, ImuSample
from service.evidence import Consistency
from service.second_opinion import LOOK_EVERY_US, Look, SecondOpinion, Verdict, in_words

PLACE = PlaceField(radians(10.0), radians(60.0), 0.5)
FIELD = (0.25 * cos(radians(10.0)), 0.25 * sin(radians(10.0)), 0.5 * sin(radians(60.0)))
NONE = ("", "")
NORTH, EAST, DOWN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def turn(axis, angle_deg):
    return exp(scale(radians(angle_deg), axis))


TRUE = multiply(turn(DOWN, 40.0), turn(NORTH, 5.0))
LATER_US = 50 * LOOK_EVERY_US  # behind what is ``reported``, of 20 s
LAST_US = LATER_US - LOOK_EVERY_US


def attitude(q, time_us=0, *, sigma_deg=1.0, heading_sigma_deg=2.0, north="true", rate=(0, 0, 0)):
    sigmas = radians(sigma_deg), radians(heading_sigma_deg)
    return Attitude(time_us, q, rate, (0.0, 0.0, 0.0), 0.0, 0.0, 20.0, 1.0, 1.0, *sigmas, north)


SEEN = rotate_inverse(TRUE, FIELD)


def reported(
    ours, theirs, *, looks=50, opinion=None, begin_us=0, place=PLACE, faults=NONE, force=None,
    field=SEEN, **sigmas
):  # fmt: skip
    """The report after so many looks at a vehicle that hovers at ``TRUE`` if ``force`` is none."""
    opinion = opinion or SecondOpinion()
    for k in range(looks):
        time_us = begin_us + k * LOOK_EVERY_US
        felt = rotate_inverse(TRUE, (0.0, 0.0, -9.81)) if force is None else force(k)
        sample = ImuSample(time_us, (0.0, 0.0, 0.0), felt, field, any(field))
        ours_now = attitude(ours, time_us, **sigmas)
        opinion.compare(Look(time_us, "ATTITUDE", theirs, ours_now, sample, place, faults))
    return opinion


def turned(axis, angle_deg):
    return multiply(turn(axis, angle_deg), TRUE)


BEHIND = turned(DOWN, degrees(-0.08 * 3.0))  # as we saw it 80 ms ago
AGREES, DIFFERS, CANNOT_TELL = Verdict.AGREES, Verdict.DIFFERS, Verdict.CANNOT_TELL


@pytest.mark.parametrize(
    ("theirs", "sigmas", "verdict"),
    [
        (TRUE, {}, AGREES),
        # nothing is reported that sigma does not allow
        (turned(NORTH, 20.0), {"sigma_deg": 5.0}, CANNOT_TELL),
        (TRUE, {"sigma_deg": 10.0}, CANNOT_TELL),
        (BEHIND, {"rate": (0.0, 0.0, 3.0)}, CANNOT_TELL),  # a lag in a fast turn
        # a heading from elsewhere than true north shows little
        *((turned(DOWN, 25.0), {"north": north}, CANNOT_TELL) for north in ("none", "magnetic")),
        *((TRUE, {"north": north}, CANNOT_TELL) for north in ("none", "magnetic")),
        *((turned(NORTH, 25.0), {"north": north}, DIFFERS) for north in ("none", "magnetic")),
    ],
)
def test_two_differ_beyond_what_sigma_lag_and_north_allow(theirs, sigmas, verdict):
    assert reported(TRUE, theirs, **sigmas).opinion.verdict is verdict


@pytest.mark.parametrize("axis", [NORTH, EAST, DOWN])
@pytest.mark.parametrize("whose", ["autopilot", "ours"])
def test_the_wrong_one_is_named(axis, whose):
    wrong = turned(axis, 20.0)
    pair = (TRUE, wrong) if whose == "autopilot" else (wrong, TRUE)
    output = reported(*pair).opinion
    assert output.verdict is DIFFERS
    # only the field shows the heading, and that agrees with ours if the compass is turned, too
    is_reported = axis != DOWN or whose == "ours"
    assert output.wrong == (whose if is_reported else "")
    assert output.axis == ("heading" if axis == DOWN else "inclination")
    assert output.off_deg == pytest.approx(20.0, abs=0.5)


def test_it_is_reported_after_some_seconds_and_agrees_at_no_time_meanwhile():
    opinion, wrong, words = reported(TRUE, TRUE), turned(EAST, 25.0), []
    for k in range(1, 30):
        reported(TRUE, wrong, looks=1, opinion=opinion, begin_us=LAST_US + k * LOOK_EVERY_US)
        words.append(opinion.opinion.verdict)
    first = words.index(DIFFERS)
    assert set(words[:first]) == {CANNOT_TELL}
    assert first * LOOK_EVERY_US * 1e-6 == pytest.approx(4.8, rel=0.2)


def test_an_autopilot_that_falls_silent_is_compared_no_more():
    opinion = reported(TRUE, TRUE)
    assert opinion.record(LAST_US + 1_000_000).verdict == "agrees"
    assert opinion.record(LAST_US + 3_000_000) is None


def test_velocity_shows_which_heading_is_right_where_there_is_no_field():
    """A vehicle that is pushed to and fro along north, and reports its velocity."""
    opinion, step_s, speed = SecondOpinion(), LOOK_EVERY_US * 1e-6, [0.0]

    def pushed(k):
        if k:  # what the last push has given comes behind it
            opinion.velocities.append(((k - 1) * LOOK_EVERY_US, (speed[0], 0.0, 0.0)))
        push = 2.0 * cos(0.5 * k * step_s)
        speed[0] += push * step_s
        return rotate_inverse(TRUE, (push, 0.0, -9.81))

    no_field = {"field": (0.0, 0.0, 0.0), "place": None}
    wrong = turned(DOWN, -30.0)
    output = reported(TRUE, wrong, looks=150, opinion=opinion, force=pushed, **no_field).opinion
    assert output.wrong == "autopilot"
    assert "velocity" in output.evidence


def test_one_sentence_has_all_that_a_person_needs():
    opinion = reported(TRUE, turned(DOWN, 25.0))
    text = in_words(opinion.record(LAST_US))
    assert text.startswith(
        "the autopilot's heading has been 25 deg off ours for 20 s, and ours is good to 2 deg; "
        "which is wrong is not known: the magnetic field is 0 deg off ours and 25 off the"
    )


def test_intervals_are_kept_with_their_largest_difference():
    opinion = reported(TRUE, turned(NORTH, 30.0))
    reported(TRUE, TRUE, opinion=opinion, begin_us=LATER_US)
    (interval,) = opinion.intervals
    assert interval.inclination_deg == pytest.approx(30.0, abs=0.1)
    assert interval.end_us < LATER_US + 10_000_000
    assert interval.wrong == "autopilot"
    assert opinion.opinion.verdict is AGREES


@pytest.mark.parametrize(("behind_us", "off_deg"), [(0, 0.0), (100_000, 5.0)])
def test_ours_is_turned_back_to_the_autopilots_time_by_its_rate(behind_us, off_deg):
    """Then the autopilot's heading is to the right of ours."""
    spinning, opinion = attitude(TRUE, rate=(0.0, 0.0, radians(50.0))), SecondOpinion()
    sample = ImuSample(behind_us, (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), FIELD, True)
    opinion.compare(Look(0, "ATTITUDE", TRUE, spinning, sample, None))
    assert opinion.opinion.heading_deg == pytest.approx(off_deg, abs=0.1)


@pytest.mark.parametrize(
    ("faults", "wrong"),
    [
        (NONE, ""),
        (("its own filter calls it not good", ""), "autopilot"),
        (("", "of ours, the bias stands at its limit"), "ours"),
        (("its own filter calls it not good", "of ours, a warning"), ""),
    ],
)
def test_where_no_evidence_names_one_what_counts_against_one_alone_does(faults, wrong):
    """A heading without a field and without velocity."""
    output = reported(TRUE, turned(DOWN, 30.0), place=None, faults=faults).opinion
    assert output.wrong == wrong
    assert all(text in output.evidence for text in faults)


def test_the_evidence_begins_anew_with_our_attitude():
    """A velocity that was gained before shows nothing of the force after a restart."""
    opinion = reported(TRUE, TRUE)
    for second in range(30):
        opinion.velocities.append((second * 1_000_000, (10.0 * second, 0.0, 0.0)))
    opinion.restart()
    output = reported(TRUE, turned(NORTH, 25.0), opinion=opinion).opinion
    assert "the mean force is 0 deg off ours" in output.evidence


@pytest.mark.parametrize("place", [PLACE, None])
def test_an_accelerometer_that_leads_ours_astray_is_nobody_s_fault_or_ours(place):
    """4 m/s^2 to the nose: the force is 8 % too large, and the dip is off as we see it."""
    tilt = turned(EAST, -degrees(atan2(4.0, 9.81)))
    force = rotate_inverse(tilt, (0.0, 0.0, -hypot(9.81, 4.0)))
    output = reported(tilt, TRUE, place=place, force=lambda _: force).opinion
    assert output.verdict is DIFFERS
    assert output.wrong == ("" if place is None else "ours")
    assert "8% off gravity's strength" in output.evidence


def test_the_evidence_that_named_one_stays_with_the_interval():
    wrong = turned(DOWN, 30.0)
    opinion = reported(TRUE, wrong, place=None, faults=("its own filter calls it not good", ""))
    reported(TRUE, wrong, place=None, opinion=opinion, begin_us=LATER_US)
    (interval,) = opinion.intervals
    assert (interval.end_us > LATER_US, interval.wrong) == (True, "autopilot")
    assert "calls it not good" in interval.evidence


def test_a_push_of_less_than_0_7_m_s2_shows_no_heading_however_seldom_velocity_comes():
    seen, step_s = Consistency(), 1.6
    for k in range(60):
        time_us, force = round(1e6 * step_s * k), rotate_inverse(TRUE, (0.6, 0.0, -9.81))
        sample = ImuSample(time_us, (0.0, 0.0, 0.0), force, (0.0, 0.0, 0.0), False)
        seen.look(TRUE, sample, step_s)
        seen.take_velocity(time_us, (0.6 * step_s * k, 0.0, 0.0))
    assert seen.turn_deg(None) is None


def test_a_look_at_an_earlier_time_begins_anew():
    wrong = turned(NORTH, 30.0)
    opinion = reported(TRUE, wrong, begin_us=100_000_000)
    assert opinion.opinion.verdict is DIFFERS
    reported(TRUE, wrong, looks=1, opinion=opinion)
    assert opinion.opinion.verdict is CANNOT_TELL


def test_a_roll_of_almost_a_half_turn_differs_by_the_short_way():
    opinion = reported(turn(NORTH, 178.8), turn(NORTH, -178.8), looks=1)
    assert opinion.record(0).roll_deg == pytest.approx(2.4, abs=0.01)
