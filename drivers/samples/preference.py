"""Which message to prefer where several report the same. They are never mixed.

Velocities differ in errors and delays, and a change of source looks like an acceleration. The order
of IMU messages is that of ``drivers.mavlink.imu_messages``.
"""

# An autopilot's filter reports without delay, a receiver 0.1 to 0.2 s late
FILTER_VELOCITY = (
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "vehicle_local_position",
    "XKF1",
    "NKF1",
    "EKF1",
)
RECEIVER_VELOCITY = (
    "vehicle_gps_position",
    "sensor_gps",
    "GPS",
    "GPS_RAW_INT",  # horizontal only
)
REPORTS = FILTER_VELOCITY + RECEIVER_VELOCITY


def report_rank(message: str) -> int:
    """Place of a message in the order of preference; those not named share the last one."""
    return REPORTS.index(message) if message in REPORTS else len(REPORTS)


def is_receiver(message: str) -> bool:
    """Whether a velocity comes straight from a satellite receiver, not from a filter."""
    return message in RECEIVER_VELOCITY
