"""MAVLink's numbers, under the names of pymavlink's definitions; HEARTBEAT_ID is a message's.

Each is looked up when it is first asked for. Source: https://mavlink.io/en/messages/common.html.
"""

import os
from functools import cache
from typing import Any

MAV_COMP_ID_AUTOPILOT1 = 1  # for views that need nothing else of MAVLink
HIGHRES_IMU_UPDATED_MAG = 0b1_1100_0000  # HIGHRES_IMU_UPDATED_XMAG, YMAG and ZMAG
UNKNOWN_UINT16 = 65535  # in most fields of 16 bits


def __getattr__(name: str) -> int:
    if name.startswith("__"):  # Python asks for those of each module
        raise AttributeError(name)
    is_message = name.endswith("_ID")
    known = f"MAVLINK_MSG_ID_{name.removesuffix('_ID')}" if is_message else name
    number = globals()[name] = int(getattr(mavlink(), known))
    return number


@cache
def mavlink() -> Any:
    """Import pymavlink's ardupilotmega dialect (it includes common), late: it takes 40 ms."""
    os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
    os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega


def is_autopilot(autopilot: int, vehicle_type: int) -> bool:
    """Whether a HEARTBEAT (MAV_AUTOPILOT, MAV_TYPE) is that of a vehicle's autopilot."""
    m = mavlink()
    return bool(autopilot != m.MAV_AUTOPILOT_INVALID and vehicle_type != m.MAV_TYPE_GCS)


def enum_name(enum: str, number: int) -> str:
    """An entry of MAV_AUTOPILOT, MAV_TYPE or the like without that; the number if unknown."""
    entry = mavlink().enums[enum].get(number)
    return str(number) if entry is None else str(entry.name).removeprefix(f"{enum}_")


@cache
def mode_name(autopilot: int | None, vehicle_type: int | None, number: int) -> str:
    """The name that people know a mode by: its ``custom_mode``, by MAV_AUTOPILOT and MAV_TYPE."""
    from pymavlink import mavutil  # late: it takes 40 ms

    if autopilot == mavlink().MAV_AUTOPILOT_PX4:
        return str(mavutil.interpret_px4_mode(1, number))
    names = mavutil.mode_mapping_bynumber(vehicle_type) or {}
    return str(names.get(number, f"mode {number}"))
