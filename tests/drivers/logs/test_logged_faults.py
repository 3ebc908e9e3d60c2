"""The same faults in every kind of log: the same words for them, a sound attitude after them."""

import math
from collections import Counter
from itertools import pairwise

import pytest

from drivers.events import ClockReset, Imu, Rejected
from drivers.logs.open import open_log
from drivers.mavlink.dialect import mavlink
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from estimator.profile import load_profile
from fuzzbee.replays.log_report import report_log
from tests.drivers.logs import test_dataflash, test_ulog

S = 1_000_000
RATE_HZ = 50.0
START_US = 1_700_000_000 * S
BEGIN_S, END_S, LAST_S = 8.0, 12.0, 24.0
HOLDS_DEG = 5.0


def flight():
    """(seconds, sample) of the paper's motion with a tenth of its noise."""
    vehicle = SimulatedVehicle(seed=6, rate_hz=RATE_HZ, noise=0.1, bias=0.1)
    for _ in range(round(LAST_S * RATE_HZ)):
        sample = next(vehicle)
        yield sample.time_us / S, sample._replace(time_us=sample.time_us + 5 * S)


def tlog(samples, folder):
    """HIGHRES_IMU, whose fields are floats, and the true attitude behind each."""
    m = mavlink()
    data, link = b"", m.MAVLink(None, srcSystem=1, srcComponent=1)
    arrival_us = START_US
    for sample in samples:
        vectors = (*sample.acc_m_s2, *sample.gyr_rad_s, *sample.mag_gauss)
        imu = m.MAVLink_highres_imu_message(sample.time_us, *vectors, 0, 0, 0, 0, 0)
        truth = m.MAVLink_sim_state_message(*sample.q_ned_frd, *[0] * 17)
        arrival_us += round(S / RATE_HZ)
        for message in (imu, truth):
            data += arrival_us.to_bytes(8, "big") + bytes(message.pack(link))
    path = folder / "flight.tlog"
    path.write_bytes(data)
    return path


def dataflash(samples, folder):
    log = test_dataflash.Writer()
    log.format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.format("MAG", "QBfff", "TimeUS,I,MagX,MagY,MagZ")
    log.format("SIM", "Qffff", "TimeUS,Q1,Q2,Q3,Q4")
    for sample in samples:
        log.write("MAG", sample.time_us, 0, *(1000 * x for x in sample.mag_gauss))
        log.write("IMU", sample.time_us, 0, *sample.gyr_rad_s, *sample.acc_m_s2)
        log.write("SIM", sample.time_us, *sample.q_ned_frd)
    return log.save(folder)


def ulog(samples, folder):
    log = test_ulog.Writer().sensors().truth()
    for sample in samples:
        log.mag(sample.time_us, sample.mag_gauss)
        log.sample(sample.time_us, sample.gyr_rad_s, sample.acc_m_s2)
        log.attitude(sample.time_us, sample.q_ned_frd)
    return log.save(folder)


WRITERS = {"tlog": tlog, "dataflash": dataflash, "ulog": ulog}
NAN_ACC = (math.nan, 0.0, -9.8)


def stuck(samples):
    first = samples[0]
    return [each._replace(gyr_rad_s=first.gyr_rad_s, acc_m_s2=first.acc_m_s2) for each in samples]


def stuck_gyroscope(samples):
    return [each._replace(gyr_rad_s=samples[0].gyr_rad_s) for each in samples]


def stuck_accelerometer(samples):
    return [each._replace(acc_m_s2=samples[0].acc_m_s2) for each in samples]


def saturated(samples):
    return [each._replace(gyr_rad_s=(34.9, *each.gyr_rad_s[1:])) for each in samples]


def clipped(samples):
    return [each._replace(acc_m_s2=(*each.acc_m_s2[:2], -156.9)) for each in samples]


def not_finite(samples):
    return [s if k % 5 else s._replace(acc_m_s2=NAN_ACC) for k, s in enumerate(samples)]


def without_acceleration(samples):
    zero = (0.0, 0.0, 0.0)
    return [s if k % 5 else s._replace(acc_m_s2=zero) for k, s in enumerate(samples)]


def spikes(samples):
    return [
        s if k % 30 else s._replace(gyr_rad_s=(s.gyr_rad_s[0] + 25.0, *s.gyr_rad_s[1:]))
        for k, s in enumerate(samples)
    ]


def duplicated(samples):
    return [sample for sample in samples for _ in range(2)]


FAULTS = {
    "stuck": (stuck, {"repeated", "stuck"}),
    "stuck gyroscope": (stuck_gyroscope, {"repeated", "gyroscope_stuck"}),
    "stuck accelerometer": (stuck_accelerometer, {"accelerometer_stuck"}),
    "saturated": (saturated, {"gyroscope_saturated", "gyroscope_spike"}),
    "clipped": (clipped, {"accelerometer_saturated"}),
    "not finite": (not_finite, {"not_finite"}),
    "zero": (without_acceleration, {"zero_accelerometer"}),
    "spikes": (spikes, {"gyroscope_spike"}),
    "duplicated": (duplicated, {"duplicate"}),
}


def damaged(fault):
    """The flight with the fault in its middle."""
    before, during, after = [], [], []
    for time_s, sample in flight():
        (before if time_s < BEGIN_S else during if time_s < END_S else after).append(sample)
    return [*before, *fault(during), *after]


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("kind", WRITERS)
def test_a_sensors_fault_is_refused_and_the_attitude_holds_after_it(kind, name, tmp_path):
    fault, reasons = FAULTS[name]
    path = WRITERS[kind](damaged(fault), tmp_path)
    report = report_log(path, load_profile("paper"), skip_s=END_S + 3.0)
    assert set(report.rejected) == reasons
    assert report.error_deg.total_rms < HOLDS_DEG


@pytest.mark.parametrize("step_s", [40.0, 3000.0])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_leap_of_the_clock_is_cut_out(kind, step_s, tmp_path):
    samples = [
        sample._replace(time_us=sample.time_us + round(step_s * S * (time_s >= BEGIN_S)))
        for time_s, sample in flight()
    ]
    path = WRITERS[kind](samples, tmp_path)
    resets = [event for event in open_log(path) if isinstance(event, ClockReset)]
    # a log that knows no arrivals cannot tell a short leap from a hole
    assert len(resets) == (1 if kind == "tlog" or step_s > 600 else 0)
    report = report_log(path, load_profile("paper"), skip_s=BEGIN_S + 5.0)
    assert report.error_deg.total_rms < HOLDS_DEG


@pytest.mark.parametrize("kind", ["tlog", "dataflash"])  # PX4 begins a new log
def test_a_reboot_in_the_middle_of_a_log_begins_a_new_stretch(kind, tmp_path):
    samples = [
        sample._replace(time_us=sample.time_us - round(S * BEGIN_S * (time_s >= BEGIN_S)))
        for time_s, sample in flight()
    ]
    path = WRITERS[kind](samples, tmp_path)
    events = list(open_log(path))
    (reset,) = [event for event in events if isinstance(event, ClockReset)]
    assert reset.reason == "reboot"
    times_us = [event.sample.time_us for event in events if isinstance(event, Imu)]
    assert all(a < b for a, b in pairwise(times_us))
    assert len(times_us) >= len(samples) - 1


@pytest.mark.parametrize("kind", WRITERS)
def test_samples_out_of_order_are_refused_or_put_in_order(kind, tmp_path):
    samples = [sample for _, sample in flight()]
    for k in range(400, 600, 10):
        samples[k], samples[k + 1] = samples[k + 1], samples[k]
    events = list(open_log(WRITERS[kind](samples, tmp_path)))
    reasons = Counter(event.reason for event in events if isinstance(event, Rejected))
    assert reasons == ({} if kind == "ulog" else {"out_of_order": 20})
