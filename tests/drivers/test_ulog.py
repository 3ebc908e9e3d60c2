"""ULog: a clip of a real PX4 flight, whole and damaged."""

import math
import random
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from drivers.events import Heartbeat, Imu, Parameter, ReferenceAttitude, Rejected, VehicleId
from drivers.logs import ULOG_MAGIC, imu_events
from drivers.ulog import Ulog
from estimator.errors import InputError

HOVER = Path(__file__).parent.parent / "data" / "px4_hover.ulg"


@pytest.fixture(scope="module")
def events():
    return list(Ulog(HOVER))


def of(kind, events):
    return [event for event in events if isinstance(event, kind)]


def test_the_vehicle_is_a_px4_quadrotor(events):
    (beat,) = of(Heartbeat, events)
    assert (beat.autopilot, beat.vehicle_type) == (12, 2)
    assert {event.vehicle for event in events} == {VehicleId(1, 1)}
    assert {"SENS_BOARD_ROT", "MAV_SYS_ID"} <= {p.name for p in of(Parameter, events)}


def test_imu_at_222_hz_without_a_gap(events):
    imus = of(Imu, events)
    gaps_us = [b.sample.time_us - a.sample.time_us for a, b in pairwise(imus)]
    assert len(imus) == 3219
    assert 1e6 / median(gaps_us) == pytest.approx(222.4, abs=0.1)
    assert max(gaps_us) < 10_000
    assert not of(Rejected, events)


def test_it_hovers_in_si_units_and_frd(events):
    samples = [event.sample for event in of(Imu, events)]
    assert median(s.acc_m_s2[2] for s in samples) == pytest.approx(-9.8, abs=0.1)
    assert median(math.hypot(*s.gyr_rad_s) for s in samples) < 0.2
    fields = [math.hypot(*s.mag_gauss) for s in samples if s.has_mag]
    assert len(fields) == 29  # 2 Hz for 14.7 s
    assert 0.2 < median(fields) < 0.7


def test_attitudes_agree_with_gravity(events):
    """A hover at constant speed: the specific force is up, to a few degrees."""
    attitudes = of(ReferenceAttitude, events)
    assert len(attitudes) == 294
    w, x, y, z = attitudes[100].q_ned_frd
    up_frd = (-2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y)))
    now_us = attitudes[100].time_us
    near = [e.sample.acc_m_s2 for e in of(Imu, events) if abs(e.sample.time_us - now_us) < 500_000]
    mean = [sum(axis) / len(near) for axis in zip(*near, strict=True)]
    cosine = sum(a * b for a, b in zip(up_frd, mean, strict=True)) / math.hypot(*mean)
    assert math.degrees(math.acos(cosine)) < 3.0


def test_events_come_in_the_order_of_their_times(events):
    arrivals = [event.arrival_us for event in events if not isinstance(event, Parameter)]
    assert arrivals == sorted(arrivals)


@pytest.mark.parametrize("seed", range(8))
def test_damaged_logs_give_what_can_be_read_or_one_line(tmp_path, capfd, seed):
    rng = random.Random(seed)
    data = bytearray(HOVER.read_bytes())
    for _ in range(40):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    del data[rng.randrange(len(data) // 2, len(data)) :]
    path = tmp_path / "hover.ulg"
    path.write_bytes(data)
    try:
        times_us = [event.sample.time_us for event in of(Imu, imu_events(Ulog(path)))]
    except InputError as error:
        assert str(error).startswith(f"{path}: ")  # noqa: PT017 - either outcome is right
    else:
        assert all(a < b for a, b in pairwise(times_us))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("size", [8, 16, 1000, 20_000])
def test_a_log_cut_off_in_its_head_has_no_imu(tmp_path, size):
    path = tmp_path / "hover.ulg"
    path.write_bytes(HOVER.read_bytes()[:size])
    with pytest.raises(InputError, match=r"hover\.ulg: "):
        list(imu_events(Ulog(path)))


def test_a_length_beyond_the_end_of_damaged_definitions_ends_the_reading(tmp_path):
    """pyulog steps back by the whole length there, and would go on so for ever."""
    path = tmp_path / "endless.ulg"
    path.write_bytes(ULOG_MAGIC + bytes(9) + b"\xff\x7f\x00" + bytes(40))
    with pytest.raises(InputError, match=r"endless\.ulg"):
        list(Ulog(path))
