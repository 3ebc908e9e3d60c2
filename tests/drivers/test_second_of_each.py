"""What only a second component, a second clock or a long flight shows of links and logs."""

import pytest

from drivers.events import VehicleId
from drivers.mavlink.constants import RAW_IMU_ID, mavlink
from drivers.mavlink.encoder import FrameEncoder, attitude, attitude_quaternion
from drivers.mavlink.framing import Frame
from drivers.mavlink.link import FrameQueue
from drivers.samples.imu_stream import MOST_HELD, Field, ImuStream, Stamp
from drivers.samples.vehicle_clock import TimeField
from estimator.reasons import Reason
from tests.drivers.logs.test_missing_imu import PX4, refusal, tlog

S = 1_000_000
VEHICLE = VehicleId(1, 1)
m = mavlink()


def test_the_heartbeat_of_a_ground_station_is_no_autopilots(tmp_path, capsys):
    """What a log lacks is asked of its autopilot, whatever else speaks under its system id."""
    other = m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)
    line = refusal(capsys, "replay", tlog(tmp_path, PX4, other))
    assert "HIGHRES_IMU" in line


def test_two_components_of_a_system_are_two_streams_under_overload():
    queue = FrameQueue(most_waiting=7)
    for k in range(4):
        for component in (1, 2):
            frame = Frame(RAW_IMU_ID, 1, component, bytes(27), 0, 27, False)
            queue.add(k, [frame])
    kept = [(us, frame.component_id) for us, frame in queue.take(10)]
    assert kept == [(3, 1), (3, 2)]


@pytest.mark.parametrize("make", [attitude, attitude_quaternion])
def test_after_seven_weeks_the_milliseconds_begin_anew(make):
    vectors = ((0.1, 0.2, 0.3), (0.0, 0.0, 0.0))
    if make is attitude_quaternion:
        vectors = ((1.0, 0.0, 0.0, 0.0), vectors[1])
    data = FrameEncoder(VEHICLE).frame(make((1 << 32) * 1000 + 5000, *vectors), 0)
    parser = m.MAVLink(None)
    (message,) = parser.parse_buffer(bytes(data))
    assert message.time_boot_ms == 5


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
