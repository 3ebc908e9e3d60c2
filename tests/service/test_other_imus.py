"""A second and a third IMU beside the one in use: how far each is off, by bytes."""

from collections import Counter
from math import radians

import pytest

from drivers.events import Imu, OtherImu
from drivers.logs.tlog import Tlog
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from estimator.geometry.quaternion import exp, rotate
from estimator.types import ImuSample
from fuzzbee.replays.trace import Replay
from service.evidence import OtherImus
from tests.drivers.mavlink.messages import frame as packed
from tests.drivers.mavlink.messages import m
from tests.service.flight_rig import ONE, PAPER, Rig

LEVEL, TILTED = exp((0.0, 0.0, 0.0)), exp((0.0, radians(6.0), 0.0))


def scaled(kind, sample, q, rate_off_rad_s):
    """A frame of another IMU that is turned by ``q`` and whose x rate is off."""
    acc = [round(x / 9.80665e-3) for x in rotate(q, sample.acc_m_s2)]
    gyr = [round(1e3 * x) for x in sample.gyr_rad_s]
    gyr[0] += round(1e3 * rate_off_rad_s)
    return packed(kind(sample.time_us // 1000, *acc, *gyr, 0, 0, 0))


def three_imus(rig):
    """Have frames hold two more IMUs; the third is turned."""
    frame = rig.frame
    rig.frame = lambda sample: (
        frame(sample)
        + scaled(m.MAVLink_scaled_imu2_message, sample, LEVEL, 0.0)
        + scaled(m.MAVLink_scaled_imu3_message, sample, TILTED, radians(5.0))
    )
    return frame


def test_a_log_skips_what_a_live_link_skips(tmp_path):
    """Both take the same readings, so that they have the same estimate to the last bit."""
    rig, records = Rig(), []
    three_imus(rig)
    rig.decoder.imu_in_use = rig.pipeline.imu_in_use
    frame = rig.frame
    rig.frame = lambda sample: records.append((rig.now_us, frame(sample))) or records[-1][1]
    rig.fly(10.0)
    path = tmp_path / "three.tlog"
    frames = ((us, one.data) for us, data in records for one in FrameReader().feed(data))
    path.write_bytes(b"".join(us.to_bytes(8, "big") + data for us, data in frames))
    replay, read = Replay(PAPER), Counter()
    handle = replay.pipeline.handle
    replay.pipeline.handle = lambda event: (read.update([type(event).__name__]), handle(event))[1]
    replay.run(Tlog(path))
    assert read["Imu"] < 1.1 * len(records)
    trace = replay.longest()
    assert {*trace.imu_messages} == {"RAW_IMU"}
    replayed = replay.pipeline.vehicle(trace.address)
    assert {*replayed.others.records(rig.now_us)} == {"SCALED_IMU2", "SCALED_IMU3"}
    assert replayed.estimator.snapshot.core == rig.vehicle.estimator.snapshot.core


def highres(sample, q, number):
    """A HIGHRES_IMU of the IMU of that number."""
    values = *rotate(q, sample.acc_m_s2), *sample.gyr_rad_s, *[0.0] * 7
    return packed(m.MAVLink_highres_imu_message(sample.time_us, *values, 63, number))


@pytest.fixture
def rig():
    """A vehicle at rest, of whose IMUs those not in use are skipped."""
    rig = Rig()
    rig.samples = SimulatedVehicle(seed=0, rate_hz=50.0, motion="rest", noise=0.1)
    rig.decoder.imu_in_use = rig.pipeline.imu_in_use
    return rig


def test_imus_that_share_a_message_are_compared_by_their_numbers(rig):
    frame = rig.frame
    rig.frame = lambda sample: (
        frame(sample)
        + highres(sample, LEVEL, 1)
        + b"".join(highres(sample, TILTED, number) for number in range(2, 40))
    )
    rig.fly(20.0)
    found = rig.status().other_imus
    assert found["HIGHRES_IMU:1"].inclination_deg < 0.5
    assert found["HIGHRES_IMU:2"].inclination_deg == pytest.approx(6.0, abs=1.5)
    assert len(found) == 16  # nobody has so many


@pytest.mark.parametrize("skips", [True, False], ids=["those not in use are skipped", "all"])
def test_a_status_has_each_imus_difference_from_the_one_in_use(rig, skips):
    read = []
    if not skips:
        rig.decoder = MavlinkDecoder(references=False)
    handle = rig.handle
    rig.handle = lambda events: (read.extend(e for e in events if isinstance(e, OtherImu)),
                                 handle(events))  # fmt: skip
    frame = three_imus(rig)
    rig.fly(20.0)
    status = rig.status()
    assert status.imu_message == "RAW_IMU"
    good, bad = status.other_imus["SCALED_IMU2"], status.other_imus["SCALED_IMU3"]
    assert good.inclination_deg < 0.5
    assert good.rate_deg_s < 0.5
    assert bad.inclination_deg == pytest.approx(6.0, abs=1.5)
    assert bad.rate_deg_s == pytest.approx(5.0, abs=0.5)
    assert len(read) == (pytest.approx(2 * 40, abs=4) if skips else 0)  # twice a second, of 50
    rig.frame = frame
    rig.fly(6.0)
    assert rig.status().other_imus == {}


def test_what_was_long_ago_is_forgotten():
    """An IMU that was tilted for a minute stands level since half a minute."""
    others, level = OtherImus(), (0.0, 0.0, -9.81)
    for k in range(180):
        us = 500_000 * (k + 1)
        ours = Imu(ONE, us, us, "RAW_IMU", ImuSample(us, (0.0,) * 3, level, (0.0,) * 3, False))
        force = rotate(TILTED, level) if k < 120 else level
        others.take(OtherImu(ONE, us, "SCALED_IMU2", (0.0,) * 3, force), ours)
    assert others.records(us)["SCALED_IMU2"].inclination_deg < 1.0
