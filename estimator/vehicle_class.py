"""What carries the IMU, as far as somebody has told: how it moves is known before it has moved."""

from enum import Enum, auto


class VehicleClass(Enum):
    """Kinds of carriers."""

    ANYTHING = auto()  # a hand, a robot's arm: quick turns, short accelerations, any gyroscope
    VEHICLE = auto()  # accelerates for long, and has the gyroscope of an autopilot
    WHEELS = auto()  # a vehicle that does not slip sideways: its velocity shows its heading
