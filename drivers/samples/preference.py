"""Of messages that tell the same, the one to prefer. They are never mixed.

IMU messages of one vehicle may come from different IMUs, mounted and calibrated
differently; velocities differ in errors and delays, and a change of source looks like
an acceleration.
"""

# RAW_IMU and HIGHRES_IMU keep the finest clock; the numbered ones are the second and third IMU
IMU = ("RAW_IMU", "HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
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
VELOCITY = FILTER_VELOCITY + RECEIVER_VELOCITY


def imu_rank(message: str) -> int:
    """Place of an IMU message in the order of preference; logs' own names come last, all alike."""
    return _rank(IMU, message)


def velocity_rank(message: str) -> int:
    """Place of a velocity message in the order of preference; unknown ones come last, all alike."""
    return _rank(VELOCITY, message)


def is_receiver(message: str) -> bool:
    """Whether a velocity is the word of a satellite receiver, which no filter has worked on."""
    return message in RECEIVER_VELOCITY


def _rank(order: tuple[str, ...], message: str) -> int:
    return order.index(message) if message in order else len(order)
