"""Compasses that mislead or are not there, and reports that come late."""

from math import degrees

import numpy as np
import pytest

from estimator.aiding.compass import is_usable
from estimator.aiding.phase import Phase
from estimator.geometry.metrics import angle_errors, batch_angle_errors, rms
from estimator.geometry.quaternion import rotate_inverse
from estimator.profile import load_profile, merge_profile
from estimator.types import ZERO_VEC3
from tests.flight import banked_flight, calibrated, flown

TRUE_NORTH = {"reference": {"declination_deg": 0.01}}
LATE_S = 40.0
TOTAL, HEADING, INCLINATION = range(3)


@pytest.fixture(scope="module")
def flight():
    return banked_flight()


def estimator(**updates):
    return calibrated(merge_profile(load_profile("imu"), {**TRUE_NORTH, **updates}))


def changed(flight, **readings):
    """The flight with each sample's fields replaced by functions of the sample."""
    samples = [s._replace(**{k: f(s) for k, f in readings.items()}) for s in flight.samples]
    return type(flight)(samples, flight.reports, flight.truth)


def late_errors_deg(flight, attitudes):
    times = np.array([s.time_us for s in flight.samples])
    estimates = np.array([a.q_ned_frd for a in attitudes])
    errors = np.degrees(batch_angle_errors(estimates, np.array(flight.truth)))
    return errors[times > LATE_S * 1e6]


def magnetised(*iron_gauss):
    return lambda sample: tuple(m + i for m, i in zip(sample.mag_gauss, iron_gauss, strict=True))


def test_without_a_magnetometer_the_heading_comes_from_velocity(flight):
    bare = changed(flight, mag_gauss=lambda _: ZERO_VEC3, has_mag=lambda _: False)
    attitudes = flown(estimator(), bare)
    assert attitudes[100].heading_reference == "none"
    assert attitudes[-1].heading_reference == "true"
    errors = late_errors_deg(flight, attitudes)
    assert rms(errors[:, HEADING]) == pytest.approx(0.0332, rel=0.2)
    assert degrees(attitudes[-1].sigma_heading_rad) == pytest.approx(0.385, rel=0.2)
    assert rms(errors[:, INCLINATION]) == pytest.approx(0.183, rel=0.2)


def test_an_uncalibrated_compass_is_calibrated_in_flight(flight):
    """0.3 gauss of hard iron beside a horizontal field of 0.22: its heading shows nothing."""
    wrong = changed(flight, mag_gauss=magnetised(0.2, -0.15, 0.17))
    one = estimator()
    one.set_field_calibrated(False)
    attitudes = flown(one, wrong)
    assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) == pytest.approx(0.186, rel=0.2)
    iron = one.snapshot.core.aided.estimate.hard_iron_gauss
    assert iron == pytest.approx((0.2, -0.15, 0.17), abs=0.0004)  # measured within 0.00034


def test_its_heading_is_not_claimed_before(flight):
    one = estimator()
    one.set_field_calibrated(False)
    assert flown(one, flight)[50].sigma_heading_rad == pytest.approx(np.pi / 4)


def test_a_field_unlike_the_places_own_is_not_taken_for_calibrated(flight):
    """Near Zurich the field is 0.48 gauss and dips 63 deg; this one dips 30."""
    wrong = changed(flight, mag_gauss=magnetised(0.3, 0.0, -0.12))
    at_home = calibrated(load_profile("imu"))
    at_home.set_position(47.4, 8.5, 400.0, 1_700_000_000_000_000)
    flown(at_home, wrong)
    now = at_home.snapshot
    iron = now.core.aided.estimate.hard_iron_gauss
    assert now.context.phase is Phase.AIDED
    assert abs(iron[0] - 0.3) < 0.0013  # measured 0.0010


def test_a_field_unlike_the_places_own_makes_the_first_heading_uncertain(flight):
    """Turned by 15 deg; its strength and dip are 0.1 gauss off those near Zurich.

    Without a turn one look at a field shows as much as many.
    """
    wrong = changed(flight, mag_gauss=magnetised(0.08, 0.08, -0.03))
    sigmas_deg = []
    for seen in (flight, wrong):
        one = calibrated(load_profile("imu"))
        one.set_position(47.4, 8.5, 400.0, 1_700_000_000_000_000)
        level = type(flight)(seen.samples[:240], flight.reports[:48], [])
        sigmas_deg.append(degrees(flown(one, level)[-1].sigma_heading_rad))
        assert one.snapshot.context.phase is Phase.AIDED
    assert sigmas_deg == pytest.approx([7.4, 14.4], rel=0.2)


@pytest.mark.parametrize("late_s", [0.1, 0.2])
def test_how_late_a_receivers_reports_are_is_learnt(flight, late_s):
    """Each report has the velocity of so long before, and allows for that."""
    steps = round(late_s * 10.0)  # ten reports a second
    reports = [
        (k, flight.reports[max(0, i - steps)][1]._replace(time_us=r.time_us, late_sigma_s=0.1))
        for i, (k, r) in enumerate(flight.reports)
    ]
    one = estimator()
    attitudes = flown(one, flight, reports=reports)
    assert one.snapshot.core.aided.estimate.receiver_lag_s == pytest.approx(0.1 * steps, abs=0.0012)
    assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) == pytest.approx(0.176, rel=0.2)


def test_another_imu_has_other_biases(flight):
    """From 30 s on the samples are another IMU's; what was learnt of the first one goes."""
    k_30 = 1500
    bias = (0.02, -0.03, 0.01)
    late = {s.time_us for s in flight.samples[k_30:]}

    def gyr(sample):
        other = sample.time_us in late
        return tuple(w + b * other for w, b in zip(sample.gyr_rad_s, bias, strict=True))

    other = changed(flight, gyr_rad_s=gyr)
    one, unaware = estimator(), estimator()
    errors = [
        late_errors_deg(flight, flown(each, other, after=after))
        for each, after in (
            (one, lambda k: one.change_imu() if k == k_30 - 1 else None),
            (unaware, None),
        )
    ]
    assert rms(errors[0][:, TOTAL]) == pytest.approx(0.222, rel=0.2)
    assert rms(errors[1][:, TOTAL]) == pytest.approx(4.69, rel=0.2)
    # measured within 0.00063
    assert one.snapshot.core.aided.estimate.gyr_bias_rad_s == pytest.approx(bias, abs=0.00075)


def errors_between(flight, attitudes, begin_s, end_s):
    times = np.array([s.time_us for s in flight.samples]) * 1e-6
    estimates = np.array([a.q_ned_frd for a in attitudes])
    errors = np.degrees(batch_angle_errors(estimates, np.array(flight.truth)))
    return errors[(times > begin_s) & (times < end_s)]


def test_a_filter_that_follows_a_receiver_is_taken_to_be_punctual(flight):
    """The receiver's reports are 0.2 s late until 30 s; then a filter's come, which are not."""
    reports = [
        (k, flight.reports[max(0, i - 2)][1]._replace(time_us=r.time_us, late_sigma_s=0.1))
        if r.time_us < 30e6
        else (k, r)
        for i, (k, r) in enumerate(flight.reports)
    ]
    attitudes = flown(estimator(), flight, reports=reports)
    assert rms(errors_between(flight, attitudes, 31.0, 60.0)[:, TOTAL]) == pytest.approx(
        0.174, rel=0.2
    )
    back = [(k, r._replace(late_sigma_s=0.1 * (r.time_us > 30e6))) for k, r in flight.reports]
    attitudes = flown(estimator(), flight, reports=back)
    assert rms(errors_between(flight, attitudes, 31.0, 60.0)[:, TOTAL]) == pytest.approx(
        0.144, rel=0.2
    )


@pytest.mark.parametrize("factor", [0.5, 100.0])
def test_the_fields_unit_and_scale_do_not_matter(flight, factor):
    """Half of reality, as from some autopilots, or microtesla."""
    scaled = changed(flight, mag_gauss=lambda s: tuple(factor * m for m in s.mag_gauss))
    errors = late_errors_deg(flight, flown(estimator(), scaled))
    assert rms(errors[:, TOTAL]) == pytest.approx(0.184, rel=0.2)


@pytest.mark.parametrize("north", [TRUE_NORTH, {}])
def test_a_field_of_nothing_but_down_or_nothing_at_all(flight, north):
    """Above a magnetic pole, and with a magnetometer whose readings are zero."""
    for field in ((0.0, 0.0, 0.5), ZERO_VEC3):
        wrong = changed(
            flight,
            mag_gauss=lambda s, field=field: rotate_inverse(
                flight.truth[s.time_us // 20_000], field
            ),
            has_mag=lambda _: True,
        )
        attitudes = flown(calibrated(merge_profile(load_profile("imu"), north)), wrong)
        assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) == pytest.approx(0.186, rel=0.2)


@pytest.mark.parametrize("has", [lambda t: t < 20e6, lambda t: t > 20e6])
def test_a_magnetometer_that_comes_or_goes_in_flight(flight, has):
    partly = changed(
        flight,
        mag_gauss=lambda s: s.mag_gauss if has(s.time_us) else ZERO_VEC3,
        has_mag=lambda s: has(s.time_us),
    )
    attitudes = flown(estimator(), partly)
    assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) == pytest.approx(0.186, rel=0.2)


def test_a_heading_by_velocity_is_true_already_when_a_position_comes(flight):
    """Where the declination is 18 deg: nothing turns by it."""
    bare = changed(flight, mag_gauss=lambda _: ZERO_VEC3, has_mag=lambda _: False)
    one = calibrated(load_profile("imu"))
    place = (60.0, -140.0, 0.0, 1_700_000_000_000_000)
    attitudes = flown(one, bare, after=lambda k: one.set_position(*place) if k == 2500 else None)
    # it turns by 1.41 and 1.40 deg in these 40 ms
    before, behind = (
        degrees(apart(attitudes[k].q_ned_frd, attitudes[k + 2].q_ned_frd)) for k in (2498, 2500)
    )
    assert before == pytest.approx(1.41, rel=0.02)
    assert behind == pytest.approx(before, abs=0.016)  # measured 0.013 less


def apart(p, q):
    return angle_errors(p, q)[TOTAL]


def test_a_magnetometer_that_comes_where_no_position_is_known_makes_the_heading_magnetic(flight):
    partly = changed(
        flight,
        mag_gauss=lambda s: s.mag_gauss if s.time_us > 30e6 else ZERO_VEC3,
        has_mag=lambda s: s.time_us > 30e6,
    )
    attitudes = flown(calibrated(load_profile("imu")), partly)
    assert attitudes[1400].heading_reference == "true"
    assert attitudes[-1].heading_reference == "magnetic"


def test_a_log_that_begins_in_a_turn_does_not_condemn_the_compass(flight):
    """Tilted by 52 deg unseen the field looks too steep; it is looked at again."""
    begin = 550  # 11 s
    late = type(flight)(
        flight.samples[begin:],
        [(k - begin, r) for k, r in flight.reports if k >= begin],
        flight.truth[begin:],
    )
    one = calibrated(load_profile("imu"))
    one.set_position(47.4, 8.5, 400.0, 1_700_000_000_000_000)
    flown(one, late)
    known = one.snapshot.context.compass
    assert known.unlike_us is not None
    assert is_usable(known, one.snapshot.core.time_us + 60_000_000)


def test_raw_vectors_for_a_while_end_the_aiding(flight):
    """Another profile comes and goes: what the aiding knew before is out of date."""
    one = calibrated(load_profile("imu"))
    one.set_field_calibrated(False)
    profiles = {1500: load_profile("paper"), 1700: load_profile("imu")}

    def replace(k):
        if k in profiles:
            one.replace_profile(profiles[k])
        if 1500 < k <= 1700:
            assert one.snapshot.context.phase is not Phase.AIDED

    attitudes = flown(one, flight, after=replace)
    assert one.snapshot.context.phase is Phase.AIDED
    assert rms(errors_between(flight, attitudes, 55.0, 60.0)[:, INCLINATION]) == pytest.approx(
        0.073, rel=0.2
    )


@pytest.mark.parametrize("known", [{"turned_rad": 1.0}, {"contradicted_us": 2_000_000}])
def test_raw_vectors_are_as_the_sensors_show_them(flight, known):
    """Whatever is known about the compass: only the profile ``imu`` turns it back, or drops it."""
    one, other = estimator(), estimator()
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


def test_a_restart_forgets_what_was_seen(flight):
    one = estimator()
    flown(one, flight)
    assert one.snapshot.context.phase is Phase.AIDED
    one.restart()
    fresh = estimator()
    assert one.snapshot == fresh.snapshot
    assert flown(one, flight) == flown(fresh, flight)


PHASES = {
    "search open": (200, {"has_mag": lambda _: False, "mag_gauss": lambda _: ZERO_VEC3}),
    "aided without field": (2000, {"has_mag": lambda _: False, "mag_gauss": lambda _: ZERO_VEC3}),
    "aided without north": (2000, {}),
}


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("interruption", ["restored", "replaced", "declared the same"])
def test_interruptions_change_nothing(flight, phase, interruption):
    """Taking the state out and putting it back, just before a report that belongs to it."""
    k_then, readings = PHASES[phase]
    other = changed(flight, **readings)
    straight, broken = calibrated(load_profile("imu")), calibrated(load_profile("imu"))
    for one in (straight, broken):
        one.set_field_calibrated("without north" not in phase)

    def interrupt(one):
        if interruption == "restored":
            one.snapshot = one.snapshot
        elif interruption == "replaced":
            one.replace_profile(one.profile)
        else:
            one.set_field_calibrated("without north" not in phase)

    behind = dict(flight.reports)
    assert k_then in behind
    for k, sample in enumerate(other.samples):
        for one in (straight, broken):
            one.update(sample)
            if k == k_then and one is broken:
                interrupt(one)
            if k in behind:
                one.update_velocity(behind[k])
            if k == k_then:
                assert (one.snapshot.context.phase is Phase.AIDED) == phase.startswith("aided")
    assert broken.snapshot == straight.snapshot


@pytest.mark.parametrize(("every", "first_us"), [(1, 6_020_000), (12, 6_240_000)])
def test_the_field_does_not_begin_with_a_heading_as_good_as_none(flight, every, first_us):
    """Half as strong as near Zurich, the field may be 54 deg off; velocity shows it in the turn."""
    half = changed(flight, mag_gauss=lambda s: tuple(0.5 * m for m in s.mag_gauss))
    kept = range(0, len(half.samples), every)
    slow = type(flight)([half.samples[k] for k in kept], [], [])
    reports = [(k // every, r) for k, r in half.reports if k % every == 0]
    one, begins_us = calibrated(load_profile("imu")), []
    one.set_position(47.4, 8.5, 400.0, 1_700_000_000_000_000)

    def note(k):
        if one.is_aided:
            begins_us.append(slow.samples[k].time_us)

    flown(one, slow, reports=reports, after=note)
    assert begins_us[0] == first_us


def test_a_gap_ends_the_search(flight):
    """How the vehicle has turned meanwhile is not known: what was shown before is void."""
    bare = changed(flight, mag_gauss=lambda _: ZERO_VEC3, has_mag=lambda _: False)
    one = estimator()
    early = type(flight)(bare.samples[:250], [x for x in flight.reports if x[0] < 250], [])
    flown(one, early)
    assert one.snapshot.core.search.evidence.windows == pytest.approx(3.81, rel=0.2)
    one.update(bare.samples[250]._replace(time_us=bare.samples[249].time_us + 1_500_000))
    assert one.snapshot.core.search.evidence.windows == 0.0
