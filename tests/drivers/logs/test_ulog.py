"""ULog: a clip of a real PX4 flight, whole and damaged."""

import random
import struct
from statistics import median

import numpy as np
import pytest

from drivers import events as given
from drivers.logs.open import ULOG_MAGIC, imu_events
from drivers.logs.ulog import Ulog
from estimator.errors import InputError
from tests.drivers.logs.writers import DATA, UlogWriter, gaps_s, imu_times, malformed, noisy, of

IMU_TOPIC = "sensor_combined"
HOVER = DATA / "px4_hover.ulg"


@pytest.fixture(scope="module")
def events():
    return list(Ulog(HOVER))


def test_a_px4_quadrotor_with_an_imu_at_222_hz_without_a_gap(events):
    (beat,) = of(given.Heartbeat, events)
    assert (beat.autopilot, beat.vehicle_type) == (12, 2)
    (cut,) = of(given.Malformed, events)  # the clip ends within a message
    assert {event.vehicle for event in events if event is not cut} == {given.VehicleId(1, 1)}
    assert {"SENS_BOARD_ROT", "MAV_SYS_ID"} <= {p.name for p in of(given.Parameter, events)}
    gaps = gaps_s(imu_times(events))
    assert len(gaps) == 3218
    assert 1 / median(gaps) == pytest.approx(222.4, abs=0.1)
    assert max(gaps) < 0.01
    assert not of(given.Rejected, events)
    arrivals = [event.arrival_us for event in events if not isinstance(event, given.Parameter)]
    assert arrivals == sorted(arrivals)


def test_readings_and_parameters_agree_with_pyulog(events):
    """It hovers, in SI units and FRD."""
    from pyulog import ULog

    theirs = ULog(str(HOVER))
    topics = {each.name: each.data for each in theirs.data_list if each.multi_id == 0}

    def vectors(topic, field, n):
        return np.column_stack([topics[topic][f"{field}[{k}]"] for k in range(n)])

    assert {e.name: e.value for e in of(given.Parameter, events)} == theirs.initial_parameters
    samples = [event.sample for event in of(given.Imu, events)]
    assert np.array_equal([s.gyr_rad_s for s in samples], vectors(IMU_TOPIC, "gyro_rad", 3))
    forces = vectors(IMU_TOPIC, "accelerometer_m_s2", 3)
    assert np.array_equal([s.acc_m_s2 for s in samples], forces)
    assert np.median(forces[:, 2]) == pytest.approx(-9.8, abs=0.1)
    fields = [s.mag_gauss for s in samples if s.has_mag]
    assert len(fields) == 29  # 2 Hz for 14.7 s
    mags = vectors("vehicle_magnetometer", "magnetometer_ga", 3).tolist()
    assert all([*field] in mags for field in fields)
    attitudes = np.array([event.q_ned_frd for event in of(given.ReferenceAttitude, events)])
    q = vectors("vehicle_attitude", "q", 4)[1:].astype(float)  # one comes before any IMU's row
    assert len(q) == len(attitudes) == 294
    assert np.abs(attitudes - q / np.linalg.norm(q, axis=1)[:, None]).max() < 1e-9


GPS_COMMON = "uint8_t fix_type;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;float s_variance_m_s"
GPS_ERAS = {
    "until 2023": ("int32_t lat;int32_t lon;int32_t alt", "3i", (473977420, 85455940, 488123)),
    "since": (
        "double latitude_deg;double longitude_deg;double altitude_msl_m",
        "3d",
        (47.397742, 8.545594, 488.123),
    ),
}


@pytest.mark.parametrize(("fields", "layout", "place"), GPS_ERAS.values(), ids=GPS_ERAS)
def test_the_receiver_s_place_and_velocity(tmp_path, fields, layout, place):
    log = UlogWriter().sensors().topic(10, "sensor_gps", f"{GPS_COMMON};{fields}")
    for k in range(5):
        now_us = 1_000_000 + 200_000 * k
        log.sample(now_us, (0.001 * k, 0, 0), (0, 0, -9.8))
        report = 3 if k else 2, 1.0, -2.0, 0.5, 0.0 if k == 4 else 0.25, *place
        log.row(10, "B4f" + layout, now_us + 1000, *report)
    events = list(Ulog(log.save(tmp_path)))
    positions, velocities = of(given.Position, events), of(given.Velocity, events)
    assert len(positions) == len(velocities) == 4
    found = positions[0].latitude_deg, positions[0].longitude_deg, positions[0].altitude_m
    assert found == pytest.approx((47.397742, 8.545594, 488.123))
    sample = velocities[0].sample
    assert (sample.velocity_ned_m_s, sample.has_vertical) == ((1.0, -2.0, 0.5), True)
    assert [each.sample.sigma_m_s for each in velocities] == [0.25, 0.25, 0.25, 0.5]
    assert sample.late_sigma_s == 0.1


def test_sums_over_an_interval_become_rates(tmp_path):
    """vehicle_imu, where there is no sensor_combined; the two intervals differ."""
    fields = "float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;"
    log = UlogWriter().topic(7, "vehicle_imu", fields + "uint16_t delta_velocity_dt")
    for k in range(3):
        sums = (0.002, -0.004, 0.001 * k, 0.0125, 0.0, -0.0490)
        log.row(7, "6fIH", 1_000_000 + 5000 * k, *sums, 4000, 5000)
    log.row(7, "6fIH", 1_015_000, *sums, 0, 5000)
    events = list(Ulog(log.save(tmp_path)))
    assert [event.reason for event in of(given.Rejected, events)] == ["no_interval"]
    samples = [event.sample for event in of(given.Imu, events)]
    assert len(samples) == 3
    assert samples[2].gyr_rad_s == pytest.approx((0.5, -1.0, 0.5), rel=1e-5)
    assert samples[2].acc_m_s2 == pytest.approx((2.5, 0.0, -9.8), rel=1e-5)


def noisy_log(rows):
    log, rng = UlogWriter().sensors(), random.Random(2)
    for k in range(rows):
        log.sample(1_000_000 + 5000 * k, noisy(rng, (0, 0, 0)), noisy(rng, (0, 0, -9.8)))
    return log.data, rng


def test_damage_costs_the_rows_it_hits(tmp_path):
    """In the middle of a row, between rows, and in a row's length."""
    (data, rng), row = noisy_log(300), 3 + 2 + 8 + 24
    head = len(UlogWriter().sensors().data)
    at = head + 100 * row
    for damaged in (
        data[: at + 10] + data[at + 20 :],
        data[:at] + rng.randbytes(500) + data[at:],
        data[:at] + b"\xff" + data[at + 1 :],
        data[:at] + b"A" * 70_000 + b"D" * 70_000 + b"F" * 70_000 + data[at:],
        data + b"\x01\x00D\x00",  # the last row ends within its topic's number
    ):
        path = tmp_path / "flight.ulg"
        path.write_bytes(damaged)
        events = list(Ulog(path))
        assert len(imu_times(events)) >= 298
        assert malformed(events)


def test_a_second_log_behind_the_first_is_not_mixed_into_it(tmp_path):
    path = tmp_path / "flight.ulg"
    path.write_bytes(2 * noisy_log(100)[0])
    events = list(Ulog(path))
    assert len(imu_times(events)) == 100
    assert malformed(events) == 1


def traps():
    """Files that claim more than they hold."""
    nested = UlogWriter()
    nested.write(b"F", b"vehicle_attitude:uint64_t timestamp;" + b"a[65535] x;")
    for inner, outer in (("b", "a"), ("c", "b"), ("d", "c"), ("a", "d")):
        nested.write(b"F", f"{outer}:{inner}[65535] y;".encode())
    for number in range(500):
        nested.write(b"A", b"\0" + struct.pack("<H", number) + b"vehicle_attitude")
    wide = UlogWriter()
    fields = b"".join(b"uint8_t f%d;" % k for k in range(4000))
    wide.write(b"F", b"vehicle_attitude:uint64_t timestamp;" + fields)
    for number in range(5000):
        wide.write(b"A", b"\0" + struct.pack("<H", number) + b"vehicle_attitude")
    endless = ULOG_MAGIC + bytes(9) + b"\xff\x7f\x00" + bytes(40)
    newer = UlogWriter().write(b"B", bytes(8) + b"\x02" + bytes(31))
    return {"nested": nested.data, "wide": wide.data, "endless": endless, "newer": newer.data}


@pytest.mark.parametrize(("name", "data"), traps().items(), ids=traps())
def test_a_trap_for_the_reader_is_refused(tmp_path, name, data):
    path = tmp_path / f"{name}.ulg"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"{name}\.ulg: "):
        list(imu_events(Ulog(path)))
