"""One vehicle's readings, judged and placed: the rules that links and logs share."""

import math

import pytest

from drivers import events as given
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.samples.imu_stream import MOST_HELD, Field, ImuStream, RepeatedField, Stamp
from drivers.samples.intake import Intake
from drivers.samples.navigation import Fix
from drivers.samples.vehicle_clock import TimeField
from estimator.reasons import Reason
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3
from tests.drivers.mavlink.messages import UNIX, VEHICLE, S, only

REST = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)
FIELD = (0.2, 0.0, 0.4)
PLACE = (47.0, 8.5, 500.0)


def stamp(raw_us, arrival_us=None):
    return Stamp(TimeField.BOOT_MS, raw_us, UNIX + raw_us if arrival_us is None else arrival_us)


def imu(intake, raw_us, arrival_us=None, gyr=ZERO_VEC3, acc=REST, mag=FIELD, name="SCALED_IMU"):
    return intake.imu(name, stamp(raw_us, arrival_us), gyr, acc, Field(mag))


def kinds(events):
    return [type(event) for event in events]


def running():
    """An intake after some IMU messages on the boot clock, and the arrival of the next."""
    intake, next_us = Intake(VEHICLE), 301 * S + 250_000
    for raw_us in range(300 * S, next_us, 250_000):
        imu(intake, raw_us)
    return intake, UNIX + next_us


def test_the_first_reading_of_a_new_boot_waits_and_is_not_lost():
    intake, arrival_us = running()
    assert imu(intake, 5 * S, arrival_us, mag=(0.1, 0.0, 0.4)) == []
    reset, first, second = imu(intake, 5_250_000, arrival_us + 250_000, mag=(0.1, 0.1, 0.4))
    assert kinds((reset, first, second)) == [given.ClockReset, given.Imu, given.Imu]
    assert (reset.reason, reset.step_s) == ("reboot", pytest.approx(5 - 301.0))
    assert reset.arrival_us == arrival_us  # of the reading that had to wait
    assert (first.boot_us, second.boot_us) == (5 * S, 5_250_000)
    assert (first.arrival_us, second.arrival_us) == (arrival_us, arrival_us + 250_000)
    assert second.sample.time_us - first.sample.time_us == 250_000
    assert first.sample.time_us == 301 * S + 20_000  # about one period of a fast stream
    assert (first.sample.mag_gauss, second.sample.mag_gauss) == ((0.1, 0.0, 0.4), (0.1, 0.1, 0.4))


@pytest.mark.parametrize("back_us", [400_000, 600_000, 1_200_000])
def test_no_stream_loses_anything_where_another_one_shows_a_second_boot(back_us):
    intake, events = Intake(VEHICLE), []
    for k in range(200):
        raw_us = 300_000 + 20_000 * k - back_us * (k >= back_us // 20_000)
        for name in ("SCALED_IMU2", "SCALED_IMU"):
            events += imu(intake, raw_us, UNIX + 20_000 * k, name=name)
    assert [each.reason for each in only(given.ClockReset, events)] == ["reboot"]
    for name in ("SCALED_IMU2", "SCALED_IMU"):
        times_us = [e.sample.time_us for e in only(given.Imu, events) if e.message == name]
        assert len(times_us) == 200
        assert times_us == sorted(set(times_us))


def moving(intake, k, raw_us, mag=FIELD):
    """A reading with noise, 50 a second."""
    gyr, acc = (1e-3 * (k % 7), 2e-3 * (k % 11), 0.0), (0.01 * (k % 5), 0.02 * (k % 3), -9.8)
    return imu(intake, raw_us, UNIX + 20_000 * k, gyr, acc, mag)


@pytest.mark.parametrize(
    ("back_us", "count", "lost"),
    [
        *((300_000, 1, 1), (300_000, 2, 2), (300_000, 3, 0)),
        *((3 * S, 1, 1), (3 * S, 2, 0)),
        *((99 * S, count, count) for count in (1, 2, 5)),
        (-99 * S, 5, 5),
        *((99 * S, count, 0) for count in (6, 60)),  # and two fresh starts
    ],
)
def test_a_clock_set_back_for_a_few_readings_costs_no_others(back_us, count, lost):
    """So few may as well be late. Those behind them are as if nothing had been."""
    intake, events = Intake(VEHICLE), []
    for k in range(600):
        raw_us = 300 * S + 20_000 * k - back_us * (500 <= k < 500 + count)
        events += moving(intake, k, raw_us)
    times_us = [event.sample.time_us for event in only(given.Imu, events)]
    assert (len(times_us), len(only(given.Rejected, events))) == (600 - lost, lost)
    assert times_us == sorted(times_us)
    resets = [(each.reason, each.goes_on) for each in only(given.ClockReset, events)]
    if count >= 6:
        assert resets == [("jump", False)] * 2
    else:
        assert times_us[-1] - times_us[0] == 599 * 20_000


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("peak_gauss", [40.0, 66.0, 120.0])
def test_a_field_that_wraps_is_out_of_range_until_it_is_back(peak_gauss, sign):
    """Integers of 16 bits hold 32.8 gauss; a magnet of 66 shows what the Earth does."""
    intake, used, refused = Intake(VEHICLE), [], 0
    for k in range(800):
        true = sign * (0.4 + peak_gauss * math.sin(math.pi * k / 800) ** 2)
        shown = 1e-3 * ((round(1e3 * true) + 32768) % 65536 - 32768)
        events = moving(intake, k, S + 20_000 * k, (0.2 + 1e-3 * (k % 3), 0.0, shown))
        used += [true for event in only(given.Imu, events) if event.sample.has_mag]
        refused += len(only(given.Rejected, events))
    assert max(map(abs, used)) <= 8.0
    assert len(used) + refused == 800


@pytest.mark.parametrize(
    ("raw_us", "is_reboot"), [(5 * S, True), (20 * S, False), (900 * S, False)]
)
def test_a_reboot_voids_the_status_of_the_filter_and_a_leap_does_not(raw_us, is_reboot):
    intake, arrival_us = running()
    intake.filter_status(arrival_us, 0, 0.0, 0.0)
    events = [imu(intake, raw_us + k * S // 4, arrival_us + k * S // 4) for k in range(6)]
    assert next(filter(None, events))[0].reason == ("reboot" if is_reboot else "jump")
    at = stamp(raw_us + 1_350_000, arrival_us + 1_350_000)
    assert bool(intake.fix("LOCAL_POSITION_NED", at, Fix((1.0, 0.0, 0.0)))) is is_reboot


@pytest.mark.parametrize(
    ("message", "sigma_m_s", "late_s"),
    [
        *((f, 0.3, 0.0) for f in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "XKF1")),
        ("vehicle_local_position", 0.3, 0.0),
        *((r, 0.5, 0.1) for r in ("GPS_RAW_INT", "GPS", "sensor_gps", "vehicle_gps_position")),
    ],
)
@pytest.mark.parametrize("position", [None, PLACE])
def test_a_receivers_velocity_is_late_and_a_filters_is_not(message, sigma_m_s, late_s, position):
    """Whatever else is in the message."""
    intake, _ = running()
    fix = Fix((1.0, -2.0, 0.5), position=position)
    velocity = intake.fix(message, stamp(301 * S), fix)[-1]
    assert velocity.sample.velocity_ned_m_s == (1.0, -2.0, 0.5)
    assert (velocity.sample.sigma_m_s, velocity.sample.late_sigma_s) == (sigma_m_s, late_s)


def test_what_is_not_finite_is_left_out_and_the_rest_is_kept():
    for fix, left in (
        (Fix((1.0, 0.0, 0.0), position=(math.nan, 8.5, 500.0)), [given.Velocity]),
        (Fix((1.0, 0.0, 0.0), sigma_m_s=math.nan), []),
        (Fix((math.inf, 0.0, 0.0), position=PLACE), [given.Position]),
    ):
        events = running()[0].fix("GPS", stamp(301 * S), fix)
        assert kinds(events) == left
    (place,) = events
    assert (place.latitude_deg, place.longitude_deg, place.altitude_m) == PLACE


def test_a_field_that_does_not_turn_with_the_vehicle_is_taken_away_and_counted():
    intake, refused = Intake(VEHICLE), []
    for k in range(500):
        angle = 0.02 * k
        moves = k < 100
        mag = (0.2 * math.cos(angle), -0.2 * math.sin(angle), 0.4) if moves else FIELD
        gyr = (0.001 * (k % 7), 0.0, 1.0 + 0.001 * (k % 5))
        events = imu(intake, S + 20_000 * k, gyr=gyr, acc=(0.001 * (k % 3), 0.0, -9.8), mag=mag)
        refused += [k for _ in only(given.Rejected, events)]
        if refused and refused[-1] == k:
            assert events[0].reason == Reason.MAGNETOMETER_STUCK
            assert not events[1].sample.has_mag
    # chance does not explain the equal readings once it has turned by 0.1 rad
    assert refused[0] in range(104, 108)
    assert refused == list(range(refused[0], 500))


def test_after_blindness_the_track_is_lost_and_it_is_reported_for_how_long():
    intake, lost = Intake(VEHICLE), []
    for k in range(200):
        is_stuck = 100 <= k < 160
        gyr = (2.0, 0.0, 0.0) if is_stuck else (0.01 * (k % 7), 0.002 * (k % 3), 0.001 * (k % 5))
        acc = (0.5, 0.0, -9.0) if is_stuck else (0.01 * (k % 3), 0.02 * (k % 5), -9.8)
        events = imu(intake, S + 20_000 * k, gyr=gyr, acc=acc, mag=(0.2 + 1e-3 * (k % 4), 0.0, 0.4))
        lost += [(k, event) for event in only(given.TrackLost, events)]
    ((k, event),) = lost
    assert k == 160
    assert event.reason == Reason.STUCK
    # 60 equal readings, of which half a second was needed to see it: 0.7 s were refused
    assert event.blind_s == pytest.approx(0.7, abs=0.14)


@pytest.mark.parametrize(
    ("place", "refused"),
    [
        *(((latitude, 8.5, 500.0), True) for latitude in (90.5, -91.0)),
        *(((47.0, longitude, 500.0), True) for longitude in (180.5, -200.0)),
        *(((47.0, 8.5, altitude), True) for altitude in (3e38, -1e9)),
        ((-90.0, 180.0, 8000.0), False),
    ],
)
def test_a_place_that_is_none_is_refused_and_its_velocity_used(place, refused):
    intake, arrival_us = running()
    at = stamp(301 * S + 300_000, arrival_us)
    events = intake.fix("GPS", at, Fix((1.0, 0.0, 0.0), position=place))
    assert kinds(events) == [given.Rejected if refused else given.Position, given.Velocity]
    if refused:
        assert events[0].reason == Reason.POSITION_OUT_OF_RANGE


@pytest.mark.parametrize("place", [(0, 0), (0, 8.5), (47.4, 0), (47.4, 8.5)])
def test_on_the_equator_and_on_greenwichs_meridian_there_are_places(place):
    assert Fix(position=(*place, 0.0)).is_solved is any(place)


def reading(stream, raw_us):
    gyr = (1e-3 * (raw_us % 977), 0.01, -0.01)
    stamp = Stamp(TimeField.TIME_USEC, raw_us, 10**12 + raw_us)
    return stream.judge(stamp, gyr, (0.1, 0.2, -9.8), Field((0.2, 0.0, 0.4)))


def test_a_clock_that_stays_back_holds_no_more_than_so_many():
    stream, refused = ImuStream(VEHICLE, "RAW_IMU"), 0
    count = 3 * MOST_HELD + 10
    for k in range(count):
        events = stream.refuse(reading(stream, S + 20_000 * k), Reason.OUT_OF_ORDER, 0)
        refused += len(events)
        assert k + 1 - refused <= MOST_HELD
    assert refused + len(stream.end()) == count


@pytest.mark.parametrize("age_us", [200_000, 200_001, -200_000, -200_001])
@pytest.mark.parametrize("is_last", [True, False])
def test_a_logged_field_holds_for_a_while_and_until_one_that_is_no_number(age_us, is_last):
    vehicle = LoggedVehicle(VEHICLE, 0)
    vehicle.at(S)
    vehicle.put_mag(FIELD)
    vehicle.at(S + age_us)
    if not is_last:
        vehicle.put_mag((math.nan, 0.0, 0.4))
    (event,) = vehicle.imu("IMU", ZERO_VEC3, REST)
    assert event.sample.has_mag is (is_last and abs(age_us) == 200_000)


def test_an_autopilot_s_unstamped_attitude_is_taken_if_it_sends_no_other():
    intake = Intake(VEHICLE)
    imu(intake, S)
    (event,) = intake.unstamped("AHRS2", UNIX, "autopilot", IDENTITY)
    assert (event.source, event.time_us) == ("autopilot", S)
    imu(intake, 2 * S)
    assert intake.wants_attitude(UNIX + S)
    assert intake.unstamped("AHRS2", UNIX + S, "autopilot", IDENTITY) == []


@pytest.mark.parametrize("ahead_us", [0, 300, 1_900])
def test_a_simulators_attitude_belongs_to_the_imu_message_that_it_comes_with(ahead_us):
    """SIM_STATE has no stamp; some send it right before the IMU message of its time."""
    intake, times_us = Intake(VEHICLE), []
    for k in range(1, 6):
        at_us = UNIX + k * S // 4
        truth = intake.unstamped("SIM_STATE", at_us - ahead_us, "sim", IDENTITY)
        times_us += [
            e.time_us for e in only(given.ReferenceAttitude, truth + imu(intake, k * S // 4, at_us))
        ]
    assert times_us == [k * S // 4 for k in range(2, 6)]


@pytest.mark.parametrize("ends", [True, False])
def test_an_attitude_that_waits_is_the_last_samples_at_the_end_or_if_the_host_is_set_back(ends):
    intake, _ = running()
    assert intake.unstamped("SIM_STATE", UNIX + 301 * S + 90_000, "sim", IDENTITY) == []
    events = intake.end() if ends else imu(intake, 301 * S + 250_000, UNIX - 3600 * S)
    assert [e.time_us for e in only(given.ReferenceAttitude, events)] == [301 * S]
    assert intake.end() == []


def test_a_field_repeated_after_the_clock_went_back_is_new():
    field = RepeatedField()
    times_us = (1_000_000, 1_239_999, 1_240_000, 1_100_000)
    assert [field.is_fresh(FIELD, us) for us in times_us] == [True, False, True, True]
