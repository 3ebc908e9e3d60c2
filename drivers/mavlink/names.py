"""MAVLink's names for the numbers in a HEARTBEAT."""


def autopilot_name(number: int) -> str:
    """MAV_AUTOPILOT without its prefix, such as ARDUPILOTMEGA or PX4; the number if unknown."""
    return _enum_name("MAV_AUTOPILOT", number)


def vehicle_type_name(number: int) -> str:
    """MAV_TYPE without its prefix, such as QUADROTOR; the number if unknown."""
    return _enum_name("MAV_TYPE", number)


def _enum_name(enum: str, number: int) -> str:
    from drivers.mavlink.dialect import mavlink

    entry = mavlink().enums[enum].get(number)
    return str(number) if entry is None else str(entry.name).removeprefix(f"{enum}_")
