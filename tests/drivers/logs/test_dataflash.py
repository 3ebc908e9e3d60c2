"""DataFlash logs: written here byte by byte in ArduPilot's layout."""

import math
import struct

import pytest

from drivers import events as given
from drivers.logs.dataflash import Dataflash
from drivers.logs.other_sensors import currents, vibrations
from estimator.geometry.frames import from_euler_rad
from estimator.types import ImuSample
from tests.drivers.logs.writers import DataflashWriter, imu_times, malformed, of
from tests.vocabulary import assert_attitude_close

G = 9.80665


def modern(seconds=4, start_us=10_000_000):
    """A 50 Hz log of firmware 4.x: microseconds, IMU instances in a field, quaternions, truth."""
    log = DataflashWriter()
    log.format("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.format("MSG", "QZ", "TimeUS,Message")
    log.format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.format("MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ")
    log.format("ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw")
    log.format("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
    log.format("XKF1", "QBfff", "TimeUS,C,VN,VE,VD")
    log.format("GPS", "QBBIHLLffff", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ")
    log.format("SIM", "Qccc", "TimeUS,Roll,Pitch,Yaw")
    log.write("MSG", start_us - 10, "ArduCopter V4.5.6 (1a2b3c4d)")
    log.write("PARM", start_us - 5, "SYSID_THISMAV", 7.0, 1.0)
    log.write("PARM", start_us - 4, "AHRS_TRIM_X", 0.03125, 0.0)
    for k in range(50 * seconds):
        now_us = start_us + 20_000 * k
        if k % 5 == 0:
            log.write("MAG", now_us, 0, 200 + k % 10, -100, 400)
            log.write("MAG", now_us, 1, 1, 2, 3)
            log.write("ATT", now_us, 10.0, -20.0, 270.0)
            log.write("XKQ", now_us, 0, 0.5, -0.5, 0.5, 0.5)
            log.write("XKQ", now_us + 7, 1, 1.0, 0.0, 0.0, 0.0)
            log.write("XKF1", now_us, 0, 1.0, -2.0, 0.5)
            log.write("XKF1", now_us + 7, 1, 9.0, 9.0, 9.0)
        if k % 10 == 0:
            place = (0, 3, 1_000_000 + 20 * k, 2300, -35.5, 149.25, 580.0, 2.0, 90.0, -0.5)
            log.write("GPS", now_us, *place)
        log.write("IMU", now_us, 0, 0.125, -0.25, 0.5, 0.25, -0.5, -9.75)
        log.write("IMU", now_us, 1, 0.0, 0.0, 0.0, 0.0, 0.0, -9.5)
        log.write("SIM", now_us, 180.0, 0.0, 0.0)
    return log


@pytest.fixture(scope="module")
def events(tmp_path_factory):
    return list(Dataflash(modern().save(tmp_path_factory.mktemp("dataflash"))))


def test_the_vehicle_is_named_by_its_parameters_and_arrivals_are_unix_times_by_the_gps(events):
    """GPS week 2300, 1000.2 s, less 18 leap seconds; the fix before came before any IMU data."""
    assert {event.vehicle for event in events} == {given.VehicleId(7, 1)}
    (beat,) = of(given.Heartbeat, events)
    assert (beat.autopilot, beat.vehicle_type) == (3, 2)
    assert {p.name: p.value for p in of(given.Parameter, events)}["AHRS_TRIM_X"] == 0.03125
    expected_s = 315_964_800 + 2300 * 604_800 + 1000.2 - 18
    assert of(given.Position, events)[0].arrival_us * 1e-6 == pytest.approx(expected_s, abs=1e-3)


def test_the_field_goes_to_the_sample_behind_it_and_no_further(events):
    imus, readings = of(given.Imu, events, "IMU"), ((0.125, -0.25, 0.5), (0.25, -0.5, -9.75))
    for k in (0, 5):
        us, field = 10_000_000 + 20_000 * k, pytest.approx((0.2 + 0.001 * k, -0.1, 0.4))
        assert imus[k].sample == ImuSample(us, *readings, field, has_mag=True)
        assert imus[k].boot_us == us
    assert [each.sample.has_mag for each in imus[:10]] == [True, False, False, False, False] * 2
    assert imu_times(events, "IMU") == [*range(10_000_000, 14_000_000, 20_000)]
    assert len(of(given.Imu, events, "IMU2")) == 200


def test_attitudes_velocities_positions_and_truth(events):
    attitude, truth = (of(given.ReferenceAttitude, events, name)[0] for name in ("ATT", "SIM"))
    assert (attitude.source, truth.source) == ("autopilot", "sim")
    expected = from_euler_rad(*map(math.radians, (10, -20, 270)))
    assert_attitude_close(attitude.q_ned_frd, expected, 1e-9)
    assert_attitude_close(truth.q_ned_frd, (0.0, 1.0, 0.0, 0.0), 1e-9)
    attitudes, velocities = of(given.ReferenceAttitude, events, "XKQ"), of(given.Velocity, events)
    assert {event.q_ned_frd for event in attitudes} == {(0.5, -0.5, 0.5, 0.5)}
    filtered = [event.sample for event in velocities if event.message == "XKF1"]
    assert {each.velocity_ned_m_s for each in filtered} == {(1.0, -2.0, 0.5)}
    position = of(given.Position, events)[0]
    place = position.latitude_deg, position.longitude_deg, position.altitude_m
    assert place == (-35.5, 149.25, 580.0)


def test_a_fix_with_and_without_vertical_velocity(tmp_path):
    """The first firmwares' GPS has no VZ: a zero there would mean a level flight."""
    log = modern(1)
    log.format("GPS", "QBBIHLLfff", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs")
    log.write("GPS", 11_000_000, 0, 3, 1_001_000, 2300, -35.5, 149.25, 580.0, 2.0, 90.0)
    first, *_, last = of(given.Velocity, list(Dataflash(log.save(tmp_path))), "GPS")
    assert (first.sample.has_vertical, last.sample.has_vertical) == (True, False)
    assert first.sample.velocity_ned_m_s == pytest.approx((0.0, 2.0, -0.5))
    assert last.sample.velocity_ned_m_s[:2] == pytest.approx((0.0, 2.0))


def test_milliseconds_of_old_firmware(tmp_path):
    """3.2.1: TimeMS, IMU2 as a message of its own, GPS with its boot time in T."""
    log = DataflashWriter()
    for name in ("IMU", "IMU2"):
        log.format(name, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.format("MAG", "Ihhh", "TimeMS,MagX,MagY,MagZ")
    log.format("EKF1", "Ifff", "TimeMS,VN,VE,VD")
    log.format("GPS", "BIHLLffffI", "Status,TimeMS,Week,Lat,Lng,Alt,Spd,GCrs,VZ,T")
    for k in range(100):
        now_ms = 100_000 + 20 * k
        for name in ("IMU", "IMU2"):
            log.write(name, now_ms, 0.0, 0.0, 0.0, 0.0, 0.0, -G)
        log.write("MAG", now_ms, 200, 0, 400 + k)
        log.write("EKF1", now_ms, 1.0, 0.0, 0.0)
        log.write("GPS", 3, 19_000_000 + 20 * k, 1851, -27.5, 152.75, 17.0, 1.0, 0.0, 0.0, now_ms)
    events = list(Dataflash(log.save(tmp_path)))
    for name in ("IMU", "IMU2"):
        assert imu_times(events, name) == [100_000_000 + 20_000 * k for k in range(100)]
    assert of(given.Velocity, events, "GPS")[-1].sample.time_us == 101_980_000
    assert len(of(given.Velocity, events, "EKF1")) == 100


def test_messages_with_other_columns_are_counted_not_fatal(tmp_path):
    log = modern(1)
    log.format("EKF1", "Qf", "TimeUS,Something")
    log.write("EKF1", 11_000_000, 1.0)
    events = list(Dataflash(log.save(tmp_path)))
    assert len(of(given.Imu, events, "IMU")) == 50
    assert malformed(events) == 1


@pytest.mark.parametrize("between", ["a garbled time", "a message of unknown type"])
def test_what_is_between_two_rows_costs_none_of_them_and_is_no_gap_of_years(tmp_path, between):
    log = modern(1)
    if between == "a garbled time":
        log.write("IMU", 11_000_000 + 2**48, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -G)
    else:
        log.data += b"\xa3\x95\x7f"
    log.data += modern(40, start_us=11_000_000).data
    events = list(Dataflash(log.save(tmp_path)))
    assert imu_times(events, "IMU") == [10_000_000 + 20_000 * k for k in range(41 * 50)]
    assert not of(given.ClockReset, events)


@pytest.mark.parametrize("length", [0, 1, 2, 3, 30, 255])
def test_a_format_of_a_length_that_cannot_be_is_passed_over(tmp_path, length):
    log = modern(1)
    head, tail = log.data.split(b"IMU\0", 1)
    log.data = head[:-1] + bytes([length]) + b"IMU\0" + tail
    events = list(Dataflash(log.save(tmp_path)))
    assert not of(given.Imu, events)
    assert malformed(events)


def test_messages_agree_with_dfreader(tmp_path, monkeypatch):
    monkeypatch.setenv("PYMAVLINK_FAST_INDEX", "0")
    from pymavlink.DFReader import DFReader_binary

    log = modern(2)
    path, names = log.save(tmp_path), {"IMU", "MAG", "ATT", "XKQ", "XKF1", "GPS", "PARM", "MSG"}
    theirs = []
    with DFReader_binary(str(path)) as reader:
        while (m := reader.recv_match(type=list(names))) is not None:
            theirs.append((m.get_type(), {key: getattr(m, key) for key in m.get_fieldnames()}))
    ours = [(name, vars(fields)) for _, name, _, fields in Dataflash(path).readings(names)]
    assert len(ours) > 250
    assert ours == theirs


@pytest.mark.parametrize("instance", ["Inst", "Instance", None])
def test_the_first_batterys_current_stands_beside_the_samples_of_its_time(tmp_path, instance):
    """Before 2017 the message was called CURR."""
    log = modern()
    log.format("CURR", "Qff", "TimeUS,Volt,Curr")
    if instance is not None:
        log.format("BAT", "QBfff", f"TimeUS,{instance},Volt,Curr,CurrTot")
    for k in range(4):
        now_us, ampere = 10_000_000 + 20_000 * k, 15.0 + k if k else math.nan
        if instance is not None:
            log.write("BAT", now_us, 0, 12.5, ampere, 0.0)
            log.write("BAT", now_us, 1, 12.5, 99.0, 0.0)
        log.write("CURR", now_us, 12.5, ampere if instance is None else 77.0)
    read = Dataflash(log.save(tmp_path))
    arrivals = [event.arrival_us for event in of(given.Imu, read)][2:8:2]
    assert currents(read, 7) == [*zip(arrivals, [16.0, 17.0, 18.0], strict=True)]


@pytest.mark.parametrize(("number", "system_id"), [(255.0, 255), (256.0, 1), (0.0, 1)])
def test_a_number_that_is_no_system_is_no_name(number, system_id, tmp_path):
    log = modern(seconds=1)
    log.data = log.data.replace(struct.pack("<f", 7.0), struct.pack("<f", number), 1)
    assert {(*event.vehicle,) for event in Dataflash(log.save(tmp_path))} == {(system_id, 1)}


@pytest.mark.parametrize(
    ("codes", "columns", "row", "clipped"),
    [
        ("BfffI", "IMU,VibeX,VibeY,VibeZ,Clip", (0, 1.0, 2.0, 3.0, 4), {0: 4}),
        ("BfffI", "IMU,VibeX,VibeY,VibeZ,Clip", (1, 1.0, 2.0, 3.0, 5), {1: 5}),
        ("fffIII", "VibeX,VibeY,VibeZ,Clip0,Clip1,Clip2", (1, 2, 3, 6, 7, 8), {0: 6, 1: 7, 2: 8}),
        ("fff", "VibeX,VibeY,VibeZ", (1.0, 2.0, 3.0), {}),
        ("ff", "VibeX,VibeY", (1.0, 2.0), None),
    ],
)
def test_vibration_of_every_firmware(tmp_path, codes, columns, row, clipped):
    log = modern()
    log.format("VIBE", f"Q{codes}", f"TimeUS,{columns}")
    log.write("VIBE", 10_000_000, *row)
    found = [*vibrations(Dataflash(log.save(tmp_path)), given.VehicleId(7, 1), None)]
    assert [each.clipped for each in found] == ([] if clipped is None else [clipped])
    assert all(each.m_s2 == (1.0, 2.0, 3.0) for each in found)
