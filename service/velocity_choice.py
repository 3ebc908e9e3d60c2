"""Which of a vehicle's velocity messages helps the estimator.

They are never mixed: their errors and delays differ, and a change of source
looks like an acceleration. The better one is used while it comes.
"""

from drivers.value import Value

# What an autopilot's filter says comes without delay, a receiver's word 0.1 to 0.2 s late.
# GPS_RAW_INT is horizontal only.
PREFERENCE = (
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "vehicle_local_position",
    "XKF1",
    "NKF1",
    "EKF1",
    "vehicle_gps_position",
    "sensor_gps",
    "GPS",
    "GPS_RAW_INT",
)
SILENCE_US = 2_000_000  # after which the next best takes over


class VelocityChoice(Value, frozen=True):
    """The message in use and when it last arrived."""

    message: str | None = None
    last_arrival_us: int = 0


def rank(message: str) -> int:
    """Place in the order of preference; unknown messages come last, all alike."""
    return PREFERENCE.index(message) if message in PREFERENCE else len(PREFERENCE)


def consider(choice: VelocityChoice, message: str, arrival_us: int) -> VelocityChoice:
    """The choice after ``message`` arrived; it is in use if ``.message`` equals it."""
    better = choice.message is None or rank(message) < rank(choice.message)
    silent = arrival_us - choice.last_arrival_us > SILENCE_US
    if better or silent or message == choice.message:
        return VelocityChoice(message, arrival_us)
    return choice
