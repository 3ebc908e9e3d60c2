"""One vehicle's events one by one: what each makes of clock, health, counts and estimator."""

import pytest

from drivers.events import BodyRates, ClockReset, Heartbeat, Imu, Parameter, Rejected, TrackLost
from estimator.estimator import Estimator
from estimator.types import ZERO_VEC3, ImuSample, RateSample, VehicleClass
from service.records import State
from service.vehicle import Vehicle
from service.vehicle_status import Load, status_record
from tests.service.flight_rig import IMU, ONE, START_US

PERIOD_US = 20_000


def report(vehicle, name, value):
    vehicle.parameters.take(Parameter(ONE, START_US, name, value), vehicle.estimator)


def status(vehicle, now_us):
    return status_record(vehicle, now_us, Load(), 0)


CLASS, CALIBRATED = "set_vehicle_class", "set_field_calibrated"
WATCHED = {CLASS, CALIBRATED, "restart", "change_imu", "set_imu_lag", "update_report"}


class Watched(Estimator):
    """An estimator that remembers what it was asked for."""

    def __init__(self, profile):
        self.calls = []
        super().__init__(profile)

    def __getattribute__(self, name):
        found = super().__getattribute__(name)
        if name not in WATCHED:
            return found
        return lambda *values: (self.calls.append((name, *values)), found(*values))[1]

    def lags_ms(self):
        """Those of gyroscope and accelerometer that it was given."""
        lags = [values for name, *values in self.calls if name == "set_imu_lag"]
        return [tuple(round(1e3 * lag_s, 2) for lag_s in each) for each in lags]


@pytest.fixture
def vehicle():
    return Vehicle(ONE, Watched(IMU))


def imu(time_us, message="RAW_IMU", arrival_us=None):
    sample = ImuSample(time_us, ZERO_VEC3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)
    arrival_us = START_US + time_us + 2_000 if arrival_us is None else arrival_us
    return Imu(ONE, arrival_us, time_us, message, sample)


def feed(vehicle, first, last, message="RAW_IMU"):
    """Samples number ``first`` to ``last``, both included, at 50 Hz."""
    for number in range(first, last + 1):
        vehicle.on_imu(imu(number * PERIOD_US, message))


def test_a_reboots_silence_is_a_gap_and_a_jumps_is_none(vehicle):
    feed(vehicle, 1, 10)
    vehicle.take(ClockReset(ONE, START_US + 3_000_000, "reboot", -0.2))
    vehicle.on_imu(imu(260_000, arrival_us=START_US + 3_202_000))
    assert vehicle.imu.worst_gap_us == 3_000_000  # from 0.202 s
    assert status(vehicle, START_US + 3_202_000).worst_gap_s == 3.0
    vehicle.take(ClockReset(ONE, START_US + 9_000_000, "jump", 60.0))
    vehicle.on_imu(imu(280_000, arrival_us=START_US + 9_002_000))
    vehicle.take(ClockReset(ONE, START_US + 9_100_000, "reboot", -0.3))
    vehicle.on_imu(imu(20_000, arrival_us=START_US + 10_000_000))  # a shorter silence
    assert vehicle.imu.worst_gap_us == 3_000_000


def test_another_imu_takes_over_after_half_a_second_with_its_own_bias(vehicle):
    feed(vehicle, 1, 10)
    feed(vehicle, 11, 34, "SCALED_IMU2")  # until 0.5 s after the last
    assert vehicle.imu.message == "RAW_IMU"
    assert vehicle.estimator.calls == []
    vehicle.on_imu(imu(36 * PERIOD_US, "SCALED_IMU2"))  # 0.52 s after it
    assert vehicle.imu.message == "SCALED_IMU2"
    assert vehicle.estimator.calls == [("change_imu",)]
    assert status(vehicle, START_US + 36 * PERIOD_US).other_imus == {}
    # its rate is measured anew, and the way from one IMU to the other is no period
    assert vehicle.imu.median_period_us == 0.0
    for number in range(38, 60, 4):
        vehicle.on_imu(imu(number * PERIOD_US, "SCALED_IMU2"))
    assert vehicle.imu.median_period_us == 4 * PERIOD_US


def test_a_blind_sensor_counts_if_it_is_the_one_in_use(vehicle):
    feed(vehicle, 1, 10)
    lost = TrackLost(ONE, START_US + 400_000, "SCALED_IMU2", "gyroscope_stuck", 1.0)
    assert vehicle.take(lost) == []
    assert vehicle.estimator.aligned
    (text,) = vehicle.take(TrackLost(ONE, START_US + 400_000, "RAW_IMU", "gyroscope_stuck", 1.0))
    assert "gyroscope_stuck for 1.0 s" in text
    assert not vehicle.estimator.aligned
    assert vehicle.attitude(START_US + 402_000) is None


def test_refusals_are_counted_of_the_imu_in_use(vehicle):
    vehicle.take(Rejected(ONE, START_US, "zero", "SCALED_IMU3"))  # none in use yet
    feed(vehicle, 1, 3)
    vehicle.take(Rejected(ONE, START_US, "zero", "SCALED_IMU3"))
    vehicle.take(Rejected(ONE, START_US, "stuck", "RAW_IMU"))
    vehicle.take(Rejected(ONE, START_US, "no_time"))
    assert vehicle.rejected == {"zero": 1, "stuck": 1, "no_time": 1}


def test_a_compass_is_judged_by_all_three_offsets(vehicle):
    for name, value in {"OFS_X": 0.0, "OFS_Y": 0.0, "OFS2_X": 3.0}.items():  # the last of another
        report(vehicle, f"COMPASS_{name}", value)
    assert vehicle.estimator.calls == []
    report(vehicle, "COMPASS_OFS_Z", 0.0)
    assert vehicle.estimator.calls == [(CALIBRATED, False)]
    report(vehicle, "COMPASS_OFS_Y", 12.0)  # one that is not zero is enough
    assert vehicle.estimator.calls == [(CALIBRATED, False), (CALIBRATED, True)]


def test_a_silence_that_lasts_is_a_gap_and_has_no_rate(vehicle):
    feed(vehicle, 1, 10)
    found = [status(vehicle, START_US + at_us) for at_us in (202_000, 902_000)]
    assert [each.worst_gap_s for each in found] == pytest.approx([0.02, 0.7])
    assert found[0].imu_rate_hz == pytest.approx(50.0)
    vehicle.on_time(START_US + 1_500_000)
    assert vehicle.state is State.DEGRADED
    assert status(vehicle, START_US + 1_500_000).imu_rate_hz == 0.0
    assert vehicle.imu.median_rate_hz == pytest.approx(50.0)


def test_an_attitude_is_never_older_than_its_sample(vehicle):
    """A host time before the last sample's arrival: the sample's own time counts."""
    feed(vehicle, 1, 10)
    record = vehicle.attitude(START_US + 100_000)
    assert record.time_boot_us == 200_000
    assert record.age_ms == 0.0
    assert vehicle.attitude(START_US + 250_000).time_boot_us == 248_000  # 2 ms on the way


@pytest.mark.parametrize(
    ("off_us", "taken"),
    [(0, True), (900_000, True), (-900_000, True), (5_000_000, False), (-5_000_000, False)],
)
def test_rates_stamped_by_another_clock_than_the_imu_s_are_not_used(vehicle, off_us, taken):
    """Some autopilots stamp ATTITUDE seconds early or late; nor are any before the first sample."""
    vehicle.on_report(BodyRates(ONE, START_US, "ATTITUDE", RateSample(0, (0.1, 0.2, 0.3))))
    assert vehicle.estimator.calls == []
    feed(vehicle, 1, 10)
    arrival_us = START_US + 10 * PERIOD_US + 3_000
    sample = RateSample(10 * PERIOD_US + 1_000 + off_us, (0.1, 0.2, 0.3))
    vehicle.on_report(BodyRates(ONE, arrival_us, "ATTITUDE", sample))
    assert (("update_report", sample) in vehicle.estimator.calls) == taken


def test_the_sensors_filters_show_how_old_the_samples_are(vehicle):
    """At low frequencies a second-order Butterworth filter of 4 Hz is 56.3 ms late."""
    for cutoff_hz in (4.0, 0.0, 4.0):  # none: nothing is known; again: what was learnt stays
        report(vehicle, "INS_GYRO_FILTER", cutoff_hz)
    report(vehicle, "INS_ACCEL_FILTER", 10.0)
    assert vehicle.estimator.lags_ms() == [(56.27, 56.27), (56.27, 22.51)]
    vehicle.estimator.restart()
    known = vehicle.estimator.snapshot.context
    assert (known.imu_lag_s, known.acc_lead_s) == pytest.approx((0.05627, 0.03376), abs=1e-5)


def test_a_heartbeat_shows_what_carries_the_imu(vehicle):
    """MAV_TYPE_GROUND_ROVER, MAV_TYPE_QUADROTOR, _GENERIC; who is not armed may be in a hand."""
    for vehicle_type, is_armed in ((10, True), (10, False), (2, True), (2, False), (0, True)):
        vehicle.take(Heartbeat(ONE, START_US + 5, 12, vehicle_type, is_armed))
    wheels, plain, anything = VehicleClass.WHEELS, VehicleClass.VEHICLE, VehicleClass.ANYTHING
    expected = [wheels, wheels, plain, anything, anything]
    assert vehicle.estimator.calls == [(CLASS, each) for each in expected]
    assert vehicle.last_arrival_us == START_US + 5


def test_ardupilots_rovers_filter_at_4_and_10_hz_unless_a_parameter_differs(vehicle):
    rover, px4 = Heartbeat(ONE, START_US, 3, 10), Heartbeat(ONE, START_US, 12, 10)
    vehicle.take(px4)
    assert vehicle.estimator.snapshot.context.imu_lag_s is None
    vehicle.take(rover)
    report(vehicle, "INS_GYRO_FILTER", 20.0)
    vehicle.take(rover)
    assert vehicle.estimator.lags_ms()[1:] == [(56.27, 22.51), (11.25, 22.51)]
