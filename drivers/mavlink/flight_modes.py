"""The names of flight modes, from pymavlink's tables."""

from functools import cache

from drivers.mavlink.constants import MAV_AUTOPILOT_PX4


@cache
def mode_name(autopilot: int | None, vehicle_type: int | None, number: int) -> str:
    """The name that people know a mode by: its ``custom_mode``, by MAV_AUTOPILOT and MAV_TYPE."""
    from pymavlink import mavutil  # late: it takes 40 ms

    if autopilot == MAV_AUTOPILOT_PX4:
        return str(mavutil.interpret_px4_mode(1, number))
    names = mavutil.mode_mapping_bynumber(vehicle_type) or {}
    return str(names.get(number, f"mode {number}"))
