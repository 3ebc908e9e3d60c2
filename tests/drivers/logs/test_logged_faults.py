"""The same faults in every kind of log: the same words for them, a sound attitude after them."""

import math
from collections import Counter
from itertools import pairwise

import pytest
from fastcrc import crc16

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
            link.seq = (link.seq + 1) % 256
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


def sentinels(samples):
    """What stands for no field in every other sample."""
    return [s if k % 2 else s._replace(mag_gauss=(3e34,) * 3) for k, s in enumerate(samples)]


def another_unit(samples):
    """Of some samples the field is no use, the rest of the row is."""
    return [
        s if k % 3 else s._replace(mag_gauss=tuple(20.0 * x for x in s.mag_gauss))
        for k, s in enumerate(samples)
    ]


def impossible_rates(samples):
    return [s if k % 5 else s._replace(gyr_rad_s=(3e38, 0.0, 0.0)) for k, s in enumerate(samples)]


def impossible_forces(samples):
    return [s if k % 5 else s._replace(acc_m_s2=(0.0, 0.0, -3e38)) for k, s in enumerate(samples)]


def wrapping(samples):
    """A spin that integers of 16 bits with mrad/s cannot hold: up to 38 rad/s and back."""
    turned = []
    for k, s in enumerate(samples):
        share = k / len(samples)
        spin = 38.0 * min(1.0, 3.0 * share, 3.0 * (1.0 - share))
        x, y, z = s.gyr_rad_s
        turned.append(s._replace(gyr_rad_s=(x, y, (z + spin + 32.768) % 65.536 - 32.768)))
    return turned


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
    "sentinels": (sentinels, {"magnetometer_out_of_range"}),
    "another unit": (another_unit, {"magnetometer_out_of_range"}),
    "impossible rates": (impossible_rates, {"gyroscope_out_of_range"}),
    "impossible forces": (impossible_forces, {"accelerometer_out_of_range"}),
    "wrapping": (wrapping, {"gyroscope_saturated"}),
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


@pytest.mark.parametrize("step_s", [-1.9, -1.2, 0.8, 1.9, 3.5])
def test_a_short_leap_beside_steady_arrivals_costs_nothing(step_s, tmp_path):
    """There and back again, and nothing is aligned anew."""
    samples = [
        sample._replace(time_us=sample.time_us + round(step_s * S * (BEGIN_S <= time_s < END_S)))
        for time_s, sample in flight()
    ]
    path = tlog([s._replace(time_us=s.time_us + 100 * S) for s in samples], tmp_path)
    events = list(open_log(path))
    resets = [event for event in events if isinstance(event, ClockReset)]
    assert [(each.reason, each.goes_on) for each in resets] == [("jump", True)] * len(resets)
    assert 1 <= len(resets) <= 2  # less than a second back is disorder
    times_us = [event.sample.time_us for event in events if isinstance(event, Imu)]
    assert max(b - a for a, b in pairwise(times_us)) < 1.2 * S
    if abs(step_s) > 1.0:
        assert len(times_us) == len(samples)
        assert times_us[-1] - times_us[0] == pytest.approx((LAST_S - 1 / RATE_HZ) * S, abs=0.1 * S)


def test_a_short_leap_where_messages_are_missing_is_a_gap(tmp_path):
    samples = [sample for time_s, sample in flight() if not BEGIN_S <= time_s < BEGIN_S + 1.9]
    path = tlog(samples, tmp_path)  # that all arrive one after the other
    data, records = bytearray(path.read_bytes()), 0
    at, kept = 0, round(BEGIN_S * RATE_HZ)
    while at < len(data):
        if records >= 2 * kept:  # the link has lost 190 frames
            data[at + 8 + 4] = (data[at + 8 + 4] + 190) % 256
        at, records = at + 8 + 12 + data[at + 9], records + 1
    path.write_bytes(_with_checksums(bytes(data)))
    events = list(open_log(path))
    assert not [event for event in events if isinstance(event, ClockReset)]
    times_us = [event.sample.time_us for event in events if isinstance(event, Imu)]
    assert max(b - a for a, b in pairwise(times_us)) == pytest.approx(1.92 * S)


def _with_checksums(data):
    """The records with the checksums of what they hold now."""
    m, at, out = mavlink(), 0, b""
    while at < len(data):
        size = data[at + 9]
        body = data[at + 9 : at + 8 + 10 + size]
        extra = m.mavlink_map[int.from_bytes(body[6:9], "little")].crc_extra
        out += data[at : at + 9] + body
        out += crc16.mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")
        at += 8 + 12 + size
    return out
