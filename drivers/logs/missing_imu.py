"""What to do about a log that has no IMU data."""

from drivers.logs.bag import IMU, Bag
from drivers.logs.dataflash import Dataflash
from drivers.logs.dataflash_format import messages
from drivers.logs.log_file import LogFile, windowed
from drivers.logs.tlog import Tlog, tlog_records
from drivers.mavlink.constants import (
    ATTITUDE_ID,
    ATTITUDE_QUATERNION_ID,
    HEARTBEAT_ID,
    is_autopilot,
)
from drivers.mavlink.framing import FieldReader
from drivers.mavlink.messages import IMU_MESSAGES, message_to_ask_for

MOST_TOPICS = 8
ATTITUDES = {ATTITUDE_ID: "ATTITUDE", ATTITUDE_QUATERNION_ID: "ATTITUDE_QUATERNION"}


def advice(log: LogFile, system_id: int | None = None) -> str | None:
    """One line for a log without IMU data: what there is instead, and how to get a better one.

    None if there is not even an attitude (of that system), or an IMU message that is of no use.
    """
    if isinstance(log, Tlog):
        return _of_telemetry(log, system_id)
    if isinstance(log, Dataflash):
        with windowed(log.path) as window:
            names = {found[0] for found in messages(window, ("ATT", "IMU")) if found is not None}
        if names != {"ATT"}:
            return None
        return "attitudes but no IMU message: set the IMU bit of LOG_BITMASK and log again"
    if isinstance(log, Bag):
        shown = log.topics()
        if any(IMU in each for each in shown):
            return None
        return f"no sensor_msgs/Imu; it has {', '.join(shown[:MOST_TOPICS]) or 'no topic'}"
    return None  # PX4 always logs sensor_combined


def _of_telemetry(log: Tlog, system_id: int | None) -> str | None:
    attitude, autopilot, reader = None, None, FieldReader()
    with windowed(log.path) as window:
        wanted = frozenset({HEARTBEAT_ID, *IMU_MESSAGES, *ATTITUDES})
        for _, frame in filter(None, tlog_records(window, wanted)):
            if system_id not in (None, frame.system_id):
                continue
            if frame.message_id in IMU_MESSAGES:
                return None
            attitude = ATTITUDES.get(frame.message_id, attitude)
            beat = reader.fields(frame) if frame.message_id == HEARTBEAT_ID else None
            if beat is not None and is_autopilot(beat.autopilot, beat.type):
                autopilot = beat.autopilot
    if attitude is None:
        return None
    message = message_to_ask_for(autopilot)
    return (
        f"{attitude} but no IMU message: ask for {message.name}: {message.setting}, "
        f"MAV_CMD_SET_MESSAGE_INTERVAL of message {message.number}, or fuzzbee run URL "
        "--request-rate 50 --record FILE"
    )
