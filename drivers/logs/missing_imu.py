"""What to do about a log that has attitudes but no IMU data."""

from drivers.logs.dataflash import Dataflash
from drivers.logs.dataflash_format import messages
from drivers.logs.log_file import whole_file
from drivers.logs.open import LogSource
from drivers.logs.tlog import Tlog, TlogRecords
from drivers.mavlink.constants import (
    ATTITUDE_ID,
    ATTITUDE_QUATERNION_ID,
    HEARTBEAT_ID,
    HIGHRES_IMU_ID,
    MAV_AUTOPILOT_PX4,
    RAW_IMU_ID,
    SCALED_IMU2_ID,
    SCALED_IMU3_ID,
    SCALED_IMU_ID,
    is_autopilot,
)
from drivers.mavlink.dialect import Unpacker

ATTITUDES = {ATTITUDE_ID: "ATTITUDE", ATTITUDE_QUATERNION_ID: "ATTITUDE_QUATERNION"}
IMUS = frozenset({RAW_IMU_ID, SCALED_IMU_ID, SCALED_IMU2_ID, SCALED_IMU3_ID, HIGHRES_IMU_ID})
ARDUPILOT = (
    "RAW_IMU: SR*_RAW_SENS = 50, MAV_CMD_SET_MESSAGE_INTERVAL of message 27, or fuzzbee run URL "
    "--request-rate 50 --record FILE"
)
PX4 = (
    "HIGHRES_IMU: mavlink stream -r 50 -s HIGHRES_IMU, MAV_CMD_SET_MESSAGE_INTERVAL of message "
    "105, or fuzzbee run URL --request-rate 50 --record FILE"
)


def advice(log: LogSource, system_id: int | None = None) -> str | None:
    """One line for a log without IMU data: what there is instead, and how to get a better one.

    None if there is not even an attitude (of that system), or an IMU message that is of no use.
    """
    if isinstance(log, Tlog):
        return _of_telemetry(log, system_id)
    if isinstance(log, Dataflash):
        with whole_file(log.path) as data:
            names = {found[0] for found in messages(data, ("ATT", "IMU")) if found is not None}
        if names != {"ATT"}:
            return None
        return "attitudes but no IMU message: set the IMU bit of LOG_BITMASK and log again"
    return None  # PX4 always logs sensor_combined


def _of_telemetry(log: Tlog, system_id: int | None) -> str | None:
    attitude, is_px4, unpacker = None, False, Unpacker()
    with whole_file(log.path) as data:
        for _, frame in TlogRecords(data, IMUS.union(ATTITUDES, {HEARTBEAT_ID})).readable():
            if system_id not in (None, frame.system_id):
                continue
            if frame.message_id in IMUS:
                return None
            attitude = ATTITUDES.get(frame.message_id, attitude)
            beat = unpacker.message(frame.data) if frame.message_id == HEARTBEAT_ID else None
            if beat is not None and is_autopilot(beat.autopilot, beat.type):
                is_px4 = beat.autopilot == MAV_AUTOPILOT_PX4
    if attitude is None:
        return None
    return f"{attitude} but no IMU message: ask for {PX4 if is_px4 else ARDUPILOT}"
