"""What only a second component, a second clock or a long flight shows of links and logs."""

from drivers.events import VehicleId
from drivers.mavlink.constants import mavlink
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
