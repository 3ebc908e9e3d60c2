"""Alarms: what contradicts an attitude is reported, and nothing else."""

from math import cos, radians, sin
from types import SimpleNamespace

import pytest

from drivers.simulation.simulated_vehicle import SimulatedVehicle
from estimator.aiding.compass import CONTRADICTED
from estimator.geometry.earth import PlaceField
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import exp, multiply, rotate_inverse, scale
from estimator.live.settings import settings_of
from estimator.types import ImuSample
from service.alarms import Alarm, Alarms
from service.pipeline import Pipeline
from tests.service.flight_rig import IMU, PAPER, START_US, fed, imu_events, statuses, texts
from tests.service.records import ATTITUDE

LEVEL = (1.0, 0.0, 0.0, 0.0)
HERE = PlaceField(0.0, radians(63.0), 0.48)
FIELD = (0.218, 0.0, 0.428)


def attitude(bias=(0.0, 0.0, 0.0), sigma_deg=1.0, heading_deg=1.0, q=LEVEL):
    made = ATTITUDE._replace(q_ned_frd=q, gyro_bias_rad_s=bias)
    sigmas = radians(sigma_deg), radians(heading_deg)
    return made._replace(sigma_inclination_rad=sigmas[0], sigma_heading_rad=sigmas[1])


KNOWN = {"place_field": HERE, "dip_error_rad": 0.0, "contradicted_axes": (False,) * 3,
         "is_aided": False, "profile": IMU,
         "compass_fault": "", "compass_off_rad": 0.0}  # fmt: skip


def lines(alarms, half, acc=(0.0, 0.0, -9.8), mag=FIELD, host_s=None, **given):
    """Have a sample looked at after so many half seconds."""
    estimator = SimpleNamespace(**{name: given.pop(name, KNOWN[name]) for name in KNOWN})
    estimator.settings = settings_of(estimator.profile)
    sample = ImuSample(half * 500_000, (0.0, 0.0, 0.0), acc, mag, has_mag=True)
    arrival_us = START_US + round(1e6 * (half / 2 if host_s is None else host_s))
    return alarms.look(sample, arrival_us, attitude(**given), estimator)


def looked(alarms, half, **given):
    """The same; returns the words that stand then."""
    lines(alarms, half, **given)
    return alarms.words


def words(seconds, place=HERE, host=lambda s: s, **given):
    """After so long of the same, or of functions of the time; ``host`` gives the host's time."""
    alarms = Alarms()
    for half in range(2 * seconds):
        now = {name: x(half / 2) if callable(x) else x for name, x in given.items()}
        looked(alarms, half, place_field=place, host_s=host(half / 2), **now)
    return alarms.words


def test_contradicted_axes_are_named_once_it_lasts():
    alarms, named = Alarms(), []
    for half in range(20):
        is_off = 3 <= half < 11
        if found := looked(alarms, half, contradicted_axes=(is_off, False, is_off)):
            assert found == {Alarm.GYROSCOPE_X, Alarm.GYROSCOPE_Z}
            named.append(0.5 * half)
    assert (named[0], named[-1]) == (2.5, 6.0)


def swinging(time_s):
    """The field swings by 54 deg to either side, twice in two seconds."""
    return (0.218, 0.3 if time_s % 2 < 1 else -0.3, 0.428)


LIMIT = radians(2.0)  # the profile's
TILTED_9 = {"dip_error_rad": radians(9), "sigma_deg": 6.0}
FIELD_WRONG, TOO_SURE = {Alarm.FIELD_IMPOSSIBLE}, {Alarm.SIGMA_TOO_SMALL}


@pytest.mark.parametrize(
    ("seconds", "given", "output"),
    [
        (8, TILTED_9, {Alarm.ACCELEROMETER}),
        (2, TILTED_9, set()),
        (60, {"dip_error_rad": radians(4), "sigma_deg": 6.0}, set()),
        # a bias at its limit counts after five seconds
        (4, {"bias": (0.0, -LIMIT, 0.0)}, set()),
        (7, {"bias": (0.0, -LIMIT, 0.0)}, {Alarm.BIAS_AT_LIMIT}),
        (60, {"bias": (0.0, -0.98 * LIMIT, 0.0)}, set()),
        (60, {"bias": (0.0, -LIMIT, 0.0), "profile": PAPER}, set()),  # its bound is 2 rad/s
        (30, {"mag": (0.218, 0.0, -0.428)}, FIELD_WRONG),  # of the other hemisphere
        (30, {"mag": (0.428, 0.0, 0.218)}, FIELD_WRONG),  # 36 deg too flat
        (30, {"mag": (1.5, 0.0, 3.0), "place": None}, FIELD_WRONG),  # of no place on Earth
        (30, {"mag": (-0.218, 0.0, 0.428), "place": None}, set()),  # nobody knows where north is
        (30, {"mag": (-0.218, 0.0, 0.428), "heading_deg": 45.0}, set()),  # unknown
        (40, {"acc": (0.0, -4.0, -9.0), "sigma_deg": 6.0}, set()),  # 24 deg
        (60, {"mag": swinging}, TOO_SURE),
        (60, {"mag": swinging, "is_aided": True}, FIELD_WRONG),
        (30, {"mag": swinging, "place": None}, TOO_SURE),
        (60, {"mag": swinging, "place": None, "heading_deg": 20.0}, set()),
    ],
)
def test_what_contradicts_the_attitude_is_named_once_it_lasts(seconds, given, output):
    assert words(seconds, **given) == output


def turned(*euler_deg):
    return from_euler_rad(*map(radians, euler_deg))


@pytest.mark.parametrize("true_deg", [(20.0, -35.0, 110.0), (-50.0, 10.0, -160.0)])
@pytest.mark.parametrize("declination_deg", [12.0, -15.0])
@pytest.mark.parametrize(
    ("off_deg", "output"),
    [(0.0, set()), (19.0, set()), (-19.0, set())]
    + [(each, {Alarm.FIELD_IMPOSSIBLE}) for each in (25.0, -25.0, 100.0, -100.0)],
)
def test_a_heading_is_held_against_the_declination_of_the_place(
    true_deg, declination_deg, off_deg, output
):
    """In any attitude it is wrong beyond 20 deg and two sigmas (2 deg) to either side."""
    east, (roll, pitch, yaw) = radians(declination_deg), true_deg
    field_ned, true = (0.218 * cos(east), 0.218 * sin(east), 0.428), turned(*true_deg)
    place, shown = PlaceField(east, radians(63.0), 0.48), turned(roll, pitch, yaw + off_deg)
    acc, mag = (rotate_inverse(true, each) for each in ((0.0, 0.0, -9.8), field_ned))
    assert words(30, acc=acc, mag=mag, place=place, q=shown) == output


@pytest.mark.parametrize(("off_deg", "output"), [(14.0, set()), (21.0, {Alarm.SIGMA_TOO_SMALL})])
def test_a_tilt_is_held_against_the_force_in_any_attitude(off_deg, output):
    """Beyond 15 deg and two sigmas of 2 deg."""
    true = turned(30.0, -20.0, 75.0)
    given = {"acc": rotate_inverse(true, (0.0, 0.0, -9.8)), "mag": (0.0, 0.0, 0.0), "place": None}
    tilted = multiply(exp(scale(radians(off_deg), (0.6, 0.8, 0.0))), true)
    assert words(40, **given, q=tilted, sigma_deg=2.0, heading_deg=90.0) == output


@pytest.mark.parametrize(
    ("pace", "set_back_s", "seconds", "output"),
    [
        (1.03, 0, 55, set()),
        (1.03, 0, 75, {Alarm.CLOCK_DRIFT}),
        (0.95, 0, 75, {Alarm.CLOCK_DRIFT}),
        (0.95, 3600, 120, {Alarm.CLOCK_DRIFT}),
        (1.01, 0, 300, set()),
        (0.9977, 0, 300, set()),  # the slowest boot clock seen: 136 ms a minute
    ],
)
def test_a_clock_some_per_cent_off_is_reported_after_a_minute(pace, set_back_s, seconds, output):
    """Though the host's clock is set back after 5 s."""
    assert words(seconds, host=lambda s: s / pace - set_back_s * (s > 5)) == output


@pytest.mark.parametrize(
    ("times_s", "given"),
    [
        # a magnet passes within two seconds
        (range(30, 60, 3), {"mag": lambda s: (0.218, 0.5, 0.428) if 30 <= s < 32 else FIELD}),
        # all that a link held back for 14 s comes at once
        (range(20, 300, 28), {"host": lambda s: s - s % 28 + max(s % 28, 14)}),
        # the host's clock is set back
        (range(20, 300, 28), {"host": lambda s: s - 3600 * (s > 40)}),
        # a link is 0.4 s late after 15 s, then prompt again
        (range(20, 300, 28), {"host": lambda s: s + 0.4 * (s % 15) / 15}),
    ],
)
def test_what_passes_and_what_is_late_contradict_nothing(times_s, given):
    assert [words(seconds, **given) for seconds in times_s] == [set()] * len(times_s)


def test_the_paper_s_signals_under_imu_are_reported():
    """Their bias is beyond what imu allows."""
    pipeline = Pipeline(IMU)
    output = texts(o for event in imu_events(2000) for o in pipeline.handle(event))
    assert "vehicle 1: warning: the gyroscope's bias stands at its limit" in output
    (status,) = statuses(pipeline.tick(START_US + 20_000_000))
    assert status.warnings == ("bias_at_limit",)


@pytest.mark.parametrize(("profile", "motion"), [("paper", "paper"), ("imu", "flight")])
def test_a_fitting_profile_raises_no_warning(profile, motion):
    pipeline = fed(imu_events(3000, source=SimulatedVehicle(5, 50.0, motion)), profile)
    (status,) = statuses(pipeline.tick(START_US + 60_000_000))
    assert status.warnings == ()


@pytest.mark.parametrize(
    ("mag_deg", "place", "off_deg"),
    [(0.0, HERE, 0.0), (90.0, HERE, -90.0), (-170.0, None, 170.0),
     (10.0, HERE._replace(declination_rad=radians(10.0)), 0.0)],
)  # fmt: skip
def test_the_compass_s_own_heading_is_less_where_its_north_is_to_the_east(mag_deg, place, off_deg):
    alarms, mag = Alarms(), (0.2 * cos(radians(mag_deg)), 0.2 * sin(radians(mag_deg)), 0.4)
    for half in range(9):
        looked(alarms, half, place_field=place, mag=mag)
    assert alarms.compass_off_deg == pytest.approx(off_deg, abs=1e-6)


def test_a_single_look_after_an_hours_silence_is_no_alarm():
    alarms = Alarms()
    looked(alarms, 0)
    assert looked(alarms, 7200, acc=(0.0, -4.0, -9.0)) == frozenset()


@pytest.mark.parametrize("off_deg", [-90, 90])
def test_a_compass_that_is_far_off_to_either_side_may_be_mounted_otherwise(off_deg):
    off = {"compass_fault": CONTRADICTED, "compass_off_rad": radians(off_deg)}
    (line,) = lines(Alarms(), 0, is_aided=True, **off)
    assert line.endswith(f"which is {off_deg}° off; is its orientation set rightly?")


def test_between_the_poles_a_field_that_points_south_is_the_places():
    """There the declination is a half turn: 179 and -179 degrees are two apart."""
    place = PlaceField(3.124, 1.2, 0.58)
    horizontal, down = 0.58 * 0.362, 0.58 * 0.932
    south, north = (-horizontal, -0.0175 * horizontal, down), (horizontal, 0.0, down)
    assert Alarm.FIELD_IMPOSSIBLE not in words(60, mag=south, place=place)
    assert Alarm.FIELD_IMPOSSIBLE in words(60, mag=north, place=place)
