"""Compasses that mislead or are not there, what is known about them, and late reports."""

from dataclasses import replace
from math import cos, degrees, radians, remainder, sin, tau

import numpy as np
import pytest

from estimator.aiding.compass import (
    Compass,
    declare,
    is_usable,
    record_giving_up,
    rejected_until_us,
    restart,
)
from estimator.aiding.phase import Phase
from estimator.conditioning.params import FORGET_S, LONG_S, MEMORY_S
from estimator.estimator import Estimator
from estimator.geometry.metrics import angle_errors
from estimator.geometry.quaternion import scale
from estimator.profile import load_profile, merge_profile
from estimator.types import ZERO_VEC3
from tests.flight import (
    HEADING,
    INCLINATION,
    TOTAL,
    ZURICH,
    banked_flight,
    calibrated,
    changed,
    errors_deg,
    everywhere,
    flown,
    north_known,
    rms_deg,
    without_field,
)

LATE_S = 40.0


@pytest.fixture(scope="module")
def flight():
    return banked_flight()


def uncalibrated():
    one = north_known()
    one.set_field_calibrated(False)
    return one


def near_zurich():
    one = calibrated(load_profile("imu"))
    one.set_position(*ZURICH)
    return one


def fields(change):
    """Samples whose field is another one."""
    return lambda sample, _: sample._replace(mag_gauss=change(sample.mag_gauss))


def magnetised(*iron_gauss):
    return fields(lambda mag: tuple(m + i for m, i in zip(mag, iron_gauss, strict=True)))


def only_while(has_mag):
    """Samples whose magnetometer is there at some times (us)."""
    return lambda s, q: s if has_mag(s.time_us) else without_field(s, q)


def test_without_a_magnetometer_the_heading_comes_from_velocity(flight):
    attitudes = flown(north_known(), changed(flight, without_field))
    assert attitudes[100].heading_reference == "none"
    assert attitudes[100].confidence_magnetic == 0.0
    assert attitudes[-1].heading_reference == "true"
    assert rms_deg(HEADING, flight, attitudes, LATE_S) == pytest.approx(0.0332, rel=0.2)
    assert degrees(attitudes[-1].sigma_heading_rad) == pytest.approx(0.385, rel=0.2)
    assert rms_deg(INCLINATION, flight, attitudes, LATE_S) == pytest.approx(0.183, rel=0.2)


def test_an_uncalibrated_compass_is_calibrated_in_flight(flight):
    one = uncalibrated()
    attitudes = flown(one, changed(flight, magnetised(0.2, -0.15, 0.17)))
    assert attitudes[50].sigma_heading_rad == pytest.approx(np.pi / 4)  # and none is claimed
    assert rms_deg(TOTAL, flight, attitudes, LATE_S) == pytest.approx(0.186, rel=0.2)
    iron = one.snapshot.core.aided.estimate.hard_iron_gauss
    assert iron == pytest.approx((0.2, -0.15, 0.17), abs=0.0004)  # measured within 0.00034


def test_a_field_unlike_the_places_own_is_not_taken_for_calibrated(flight):
    at_home = near_zurich()
    flown(at_home, changed(flight, magnetised(0.3, 0.0, -0.12)))
    now = at_home.snapshot
    iron = now.core.aided.estimate.hard_iron_gauss
    assert now.context.phase is Phase.AIDED
    assert abs(iron[0] - 0.3) < 0.0013  # measured 0.0010


def test_a_field_unlike_the_places_own_makes_the_first_heading_uncertain(flight):
    sigmas_deg = []
    for seen in (flight, changed(flight, magnetised(0.08, 0.08, -0.03))):
        one = near_zurich()
        level = replace(seen, samples=seen.samples[:240], reports=flight.reports[:48])
        sigmas_deg.append(degrees(flown(one, level)[-1].sigma_heading_rad))
        assert one.snapshot.context.phase is Phase.AIDED
    assert sigmas_deg == pytest.approx([7.4, 14.4], rel=0.2)


def late_reports(flight, steps):
    """Each has the velocity of so many before, and allows for that."""
    velocities = [flight.reports[0][1]] * steps + [report for _, report in flight.reports]
    return [
        (k, velocity._replace(time_us=report.time_us, late_sigma_s=0.1))
        for (k, report), velocity in zip(flight.reports, velocities, strict=False)
    ]


@pytest.mark.parametrize("late_s", [0.1, 0.2])
def test_how_late_a_receivers_reports_are_is_learnt(flight, late_s):
    steps = round(late_s * 10.0)  # ten reports a second
    reports, one = late_reports(flight, steps), north_known()
    attitudes = flown(one, flight, reports=reports)
    assert one.snapshot.core.aided.estimate.receiver_lag_s == pytest.approx(0.1 * steps, abs=0.0012)
    assert rms_deg(TOTAL, flight, attitudes, LATE_S) == pytest.approx(0.176, rel=0.2)


def test_another_imu_has_other_biases(flight):
    k_30, bias = 1500, (0.02, -0.03, 0.01)

    def other_imu(s, _):
        is_other = s.time_us >= flight.samples[k_30].time_us
        gyr = (w + b * is_other for w, b in zip(s.gyr_rad_s, bias, strict=True))
        return s._replace(gyr_rad_s=tuple(gyr))

    other, one, unaware = changed(flight, other_imu), north_known(), north_known()
    aware = flown(one, other, after=lambda k: one.change_imu() if k == k_30 - 1 else None)
    assert rms_deg(TOTAL, flight, aware, LATE_S) == pytest.approx(0.222, rel=0.2)
    wrong = flown(unaware, other)
    assert rms_deg(TOTAL, flight, wrong, LATE_S) == pytest.approx(4.69, rel=0.2)
    # measured within 0.00063
    assert one.snapshot.core.aided.estimate.gyr_bias_rad_s == pytest.approx(bias, abs=0.00075)


def test_a_filter_that_follows_a_receiver_is_taken_to_be_punctual(flight):
    both = zip(late_reports(flight, 2), flight.reports, strict=True)
    reports = [late if late[1].time_us < 30e6 else prompt for late, prompt in both]
    back = [(k, r._replace(late_sigma_s=0.1 * (r.time_us > 30e6))) for k, r in flight.reports]
    for each, total_deg in ((reports, 0.174), (back, 0.144)):
        attitudes = flown(north_known(), flight, reports=each)
        assert rms_deg(TOTAL, flight, attitudes, 31.0) == pytest.approx(total_deg, rel=0.2)


UNHELPFUL = {
    # half of reality, as from some autopilots, or microtesla
    "scaled by half": fields(lambda mag: scale(0.5, mag)),
    "in microtesla": fields(lambda mag: scale(100.0, mag)),
    "above a magnetic pole": everywhere(0.0, 0.0, 0.5),
    "with readings that are zero": everywhere(*ZERO_VEC3),
    "gone after 20 s": only_while(lambda time_us: time_us < 20e6),
    "come after 20 s": only_while(lambda time_us: time_us > 20e6),
}
# where nobody knows north, one that comes or goes changes the heading's reference
NORTHLESS = ["above a magnetic pole", "with readings that are zero"]


@pytest.mark.parametrize(
    ("name", "has_north"),
    [(each, True) for each in UNHELPFUL] + [(each, False) for each in NORTHLESS],
)
def test_a_magnetometer_that_does_not_help(flight, name, has_north):
    """Velocity knows the attitude."""
    one = north_known() if has_north else calibrated(load_profile("imu"))
    attitudes = flown(one, changed(flight, UNHELPFUL[name]))
    assert rms_deg(TOTAL, flight, attitudes, LATE_S) == pytest.approx(0.185, rel=0.2)


def test_a_heading_by_velocity_is_true_already_when_a_position_comes(flight):
    one = calibrated(load_profile("imu"))
    place = (60.0, -140.0, 0.0, 1_700_000_000_000_000)
    attitudes = flown(
        one,
        changed(flight, without_field),
        after=lambda k: one.set_position(*place) if k == 2500 else None,
    )
    # it turns by 1.41 and 1.40 deg in these 40 ms
    before, behind = (
        degrees(angle_errors(attitudes[k].q_ned_frd, attitudes[k + 2].q_ned_frd)[TOTAL])
        for k in (2498, 2500)
    )
    assert before == pytest.approx(1.41, rel=0.02)
    assert behind == pytest.approx(before, abs=0.016)  # measured 0.013 less


def test_a_magnetometer_that_comes_where_no_position_is_known_makes_the_heading_magnetic(flight):
    partly = changed(flight, only_while(lambda time_us: time_us > 30e6))
    attitudes = flown(calibrated(load_profile("imu")), partly)
    assert attitudes[1400].heading_reference == "true"
    assert attitudes[-1].heading_reference == "magnetic"


def test_a_log_that_begins_in_a_turn_does_not_condemn_the_compass(flight):
    """Tilted by 52 deg unseen the field looks too steep; it is looked at again."""
    begin = 550  # 11 s
    reports = [(k - begin, r) for k, r in flight.reports if k >= begin]
    late, one = replace(flight, samples=flight.samples[begin:], reports=reports), near_zurich()
    flown(one, late)
    known = one.snapshot.context.compass
    assert known.unlike_us is not None
    assert is_usable(known, one.snapshot.core.time_us + 60_000_000)


@pytest.mark.parametrize("known", [{"turned_rad": 1.0}, {"contradicted_us": 2_000_000}])
def test_raw_vectors_are_as_the_sensors_show_them(flight, known):
    """Whatever is known about the compass: only the profile ``imu`` turns it back, or drops it."""
    one, other = north_known(), north_known()
    for k, sample in enumerate(flight.samples[:400]):
        if k == 100:
            compass = one.snapshot.context.compass._replace(**known)
            context = one.snapshot.context._replace(compass=compass)
            one.snapshot = one.snapshot._replace(context=context)
            for each in (one, other):
                each.replace_profile(load_profile("paper"))
        one.update(sample)
        other.update(sample)
    now_us = flight.samples[399].time_us
    assert one.attitude(now_us).q_ned_frd == other.attitude(now_us).q_ned_frd


@pytest.mark.parametrize(("every", "first_us"), [(1, 6_020_000), (12, 6_240_000)])
def test_the_field_does_not_begin_with_a_heading_as_good_as_none(flight, every, first_us):
    """Half as strong as near Zurich, the field may be 54 deg off; velocity shows it in the turn."""
    half = changed(flight, UNHELPFUL["scaled by half"])
    slow = replace(half, samples=half.samples[::every])
    reports = [(k // every, r) for k, r in half.reports if k % every == 0]
    one, begins_us = near_zurich(), []

    def note(k):
        if one.is_aided:
            begins_us.append(slow.samples[k].time_us)

    flown(one, slow, reports=reports, after=note)
    assert begins_us[0] == first_us


PROFILE = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0.0}})
LONG_FLIGHT = banked_flight(seconds=90.0)


def mounted(sample, angle_deg):
    """The sample as a compass reads it that is mounted ``angle_deg`` about the body's down axis."""
    x, y, z = sample.mag_gauss
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    return sample._replace(mag_gauss=(c * x - s * y, s * x + c * y, z))


def heading_errors_deg(flight, estimator):
    return errors_deg(flight, flown(estimator, flight))[:, HEADING]


@pytest.mark.parametrize("angle_deg", [-90.0, 60.0, 90.0, 180.0])
def test_a_turned_compass_is_read_as_it_is_mounted_once_velocity_shows_the_heading(angle_deg):
    """With velocity and afterwards, when it alone gives the heading: then its iron shows, too."""
    flight = changed(LONG_FLIGHT, lambda sample, _: mounted(sample, angle_deg))
    flight = replace(flight, reports=LONG_FLIGHT.reports[: 2 * len(LONG_FLIGHT.reports) // 3])
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(flight, estimator)
    assert errors[len(errors) // 2 :].max() < 7.0  # measured 5.4
    assert estimator.compass_fault == "velocity contradicts the compass"
    off_deg = degrees(remainder(estimator.compass_off_rad - radians(angle_deg), tau))
    assert abs(off_deg) < 5.0
    late = estimator.attitude(flight.samples[-1].time_us)
    assert late.heading_reference == "true"


def test_a_compass_that_velocity_confirms_goes_on_giving_the_heading():
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(LONG_FLIGHT, estimator)
    assert errors[len(errors) // 2 :].max() < 3.0
    assert estimator.compass_fault == ""


NOW_US = 500_000_000
AGAIN_US, MISLED_US, UNLIKE_US = (int(1e6 * s) for s in (LONG_S, FORGET_S, MEMORY_S))


DECLARED = declare(Compass(), True)


def given_up_twice(apart_us=AGAIN_US - 1):
    return record_giving_up(record_giving_up(DECLARED, NOW_US - apart_us), NOW_US)


UNLIKE = DECLARED._replace(unlike_us=NOW_US)
CONTRADICTED = DECLARED._replace(contradicted_us=NOW_US)


@pytest.mark.parametrize(
    ("known", "passed_us", "usable"),
    [
        (Compass(), 0, False),  # it has to be declared calibrated
        (DECLARED, 0, True),
        (declare(DECLARED, False), 0, False),
        (Compass(confirmed=True), 0, True),  # velocity confirms only one without a declaration
        (Compass(declared_calibrated=False, confirmed=True), 0, False),
        (record_giving_up(DECLARED, NOW_US), 0, True),
        (given_up_twice(AGAIN_US), 0, True),
        (given_up_twice(), MISLED_US - 1, False),  # twice in a row counts for a while
        (given_up_twice(), MISLED_US, True),
        (UNLIKE, UNLIKE_US - 1, False),  # a field unlike the place's own
        (UNLIKE, UNLIKE_US, True),
        (CONTRADICTED, 0, False),  # until velocity confirms it
        (CONTRADICTED._replace(confirmed=True), 0, True),
    ],
)
def test_what_is_known_shows_whether_a_compass_is_usable(known, passed_us, usable):
    assert is_usable(known, NOW_US + passed_us) is usable


def test_a_contradicted_compass_is_rejected_until_velocity_confirms_it():
    assert rejected_until_us(CONTRADICTED) == NOW_US + MISLED_US
    assert rejected_until_us(CONTRADICTED._replace(confirmed=True)) < 0
    # to declare the same again is no news: a ground station may fetch the parameters at any time
    assert declare(given_up_twice(), True) == given_up_twice()
    assert is_usable(declare(declare(given_up_twice(), False), True), NOW_US)


def test_a_reboot_leaves_what_was_declared():
    """Times before it are of another clock."""
    assert restart(given_up_twice()) == DECLARED
    once = restart(record_giving_up(DECLARED, NOW_US))
    assert is_usable(record_giving_up(once, 1_000_000), 1_000_000)
    assert not is_usable(restart(declare(Compass(), False)), 0)
