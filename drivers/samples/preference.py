"""Of messages that report the same, the one to prefer. They are never mixed.

Velocities differ in errors and delays, and a change of source looks like an acceleration. The order
of IMU messages is that of ``drivers.mavlink.imu_messages``.
"""

# What an autopilot's filter says comes without delay, a receiver's word 0.1 to 0.2 s late
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
    """Place of a message in the order of preference; those not named come last, all alike."""
    return REPORTS.index(message) if message in REPORTS else len(REPORTS)


def is_receiver(message: str) -> bool:
    """Whether a velocity is the word of a satellite receiver, which no filter has worked on."""
    return message in RECEIVER_VELOCITY
