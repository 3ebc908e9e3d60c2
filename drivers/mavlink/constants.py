"""MAVLink's numbers, under the names that common.xml and ardupilotmega.xml give them.

All other definitions are pymavlink's: :func:`mavlink`.
Source: https://mavlink.io/en/messages/common.html.
"""

import os
from functools import cache
from typing import Any

# Messages
HEARTBEAT_ID = 0
PARAM_VALUE_ID = 22
GPS_RAW_INT_ID = 24
SCALED_IMU_ID = 26
RAW_IMU_ID = 27
ATTITUDE_ID = 30
ATTITUDE_QUATERNION_ID = 31
ATTITUDE_QUATERNION_COV_ID = 61
LOCAL_POSITION_NED_ID = 32
GLOBAL_POSITION_INT_ID = 33
COMMAND_LONG_ID = 76
COMMAND_ACK_ID = 77
HIGHRES_IMU_ID = 105
SIM_STATE_ID = 108
SCALED_IMU2_ID = 116
SCALED_IMU3_ID = 129
AUTOPILOT_VERSION_ID = 148
SIMSTATE_ID = 164
AHRS2_ID = 178
EKF_STATUS_REPORT_ID = 193
ESTIMATOR_STATUS_ID = 230
STATUSTEXT_ID = 253

MAV_AUTOPILOT_GENERIC = 0
MAV_AUTOPILOT_ARDUPILOTMEGA = 3
MAV_AUTOPILOT_INVALID = 8  # no autopilot: a camera, a ground station, a companion computer
MAV_AUTOPILOT_PX4 = 12

MAV_CMD_SET_MESSAGE_INTERVAL = 511

MAV_COMP_ID_AUTOPILOT1 = 1
MAV_COMP_ID_ONBOARD_COMPUTER = 191

MAV_PROTOCOL_CAPABILITY_MAVLINK2 = 0b10_0000_0000_0000

MAV_PARAM_TYPE_REAL32 = 9

MAV_RESULT_ACCEPTED = 0
MAV_RESULT_TEMPORARILY_REJECTED = 1
MAV_RESULT_DENIED = 2
MAV_RESULT_UNSUPPORTED = 3
MAV_RESULT_FAILED = 4
MAV_RESULT_IN_PROGRESS = 5

MAV_MODE_FLAG_SAFETY_ARMED = 128

MAV_STATE_STANDBY = 3
MAV_STATE_ACTIVE = 4
MAV_SEVERITY_WARNING = 4
MAV_SEVERITY_INFO = 6

MAV_TYPE_GENERIC = 0
MAV_TYPE_FIXED_WING = 1
MAV_TYPE_QUADROTOR = 2
MAV_TYPE_ANTENNA_TRACKER = 5
MAV_TYPE_GCS = 6
MAV_TYPE_AIRSHIP = 7
MAV_TYPE_GROUND_ROVER = 10
MAV_TYPE_SUBMARINE = 12
MAV_TYPE_ONBOARD_CONTROLLER = 18

GPS_FIX_TYPE_3D_FIX = 3
HIGHRES_IMU_UPDATED_MAG = 0b1_1100_0000  # HIGHRES_IMU_UPDATED_XMAG, YMAG and ZMAG
UNKNOWN_UINT16 = 65535  # in most fields of 16 bits


def mavlink() -> Any:
    """Import pymavlink's ardupilotmega dialect (it includes common), late: it takes 40 ms."""
    os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
    os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega


def is_autopilot(autopilot: int, vehicle_type: int) -> bool:
    """Whether a HEARTBEAT (MAV_AUTOPILOT, MAV_TYPE) is that of a vehicle's autopilot."""
    return autopilot != MAV_AUTOPILOT_INVALID and vehicle_type != MAV_TYPE_GCS


def autopilot_name(number: int) -> str:
    """MAV_AUTOPILOT without its prefix, such as ARDUPILOTMEGA or PX4; the number if unknown."""
    return _enum_name("MAV_AUTOPILOT", number)


def vehicle_type_name(number: int) -> str:
    """MAV_TYPE without its prefix, such as QUADROTOR; the number if unknown."""
    return _enum_name("MAV_TYPE", number)


def _enum_name(enum: str, number: int) -> str:
    entry = mavlink().enums[enum].get(number)
    return str(number) if entry is None else str(entry.name).removeprefix(f"{enum}_")


@cache
def mode_name(autopilot: int | None, vehicle_type: int | None, number: int) -> str:
    """The name that people know a mode by: its ``custom_mode``, by MAV_AUTOPILOT and MAV_TYPE."""
    from pymavlink import mavutil  # late: it takes 40 ms

    if autopilot == MAV_AUTOPILOT_PX4:
        return str(mavutil.interpret_px4_mode(1, number))
    names = mavutil.mode_mapping_bynumber(vehicle_type) or {}
    return str(names.get(number, f"mode {number}"))
