"""The whole state of an estimator: what compiled steps change, and what Python keeps beside it."""

from typing import Any, NamedTuple

from estimator.aiding.compass import Compass
from estimator.aiding.phase import Phase
from estimator.aiding.place import Whereabouts
from estimator.live.core import Core
from estimator.vehicle_class import VehicleClass


class Context(NamedTuple):
    """What Python keeps beside the core."""

    phase: Phase = Phase.EMPTY
    reports: tuple[Any, ...] = ()  # of other sources than velocity, that wait for the IMU
    compass: Compass = Compass()  # how far the field is trusted
    is_by_field: bool = False  # whether the aiding began with the field's heading
    whereabouts: Whereabouts = Whereabouts()  # and the field of the place
    imu_lag_s: float | None = None  # of the gyroscope's samples, as far as somebody has told
    acc_lead_s: float = 0.0  # by how much the accelerometer's are younger
    vehicle_class: VehicleClass = VehicleClass.ANYTHING  # of the IMU, as far as somebody has told


class Snapshot(NamedTuple):
    """Everything that changes. Restoring it resumes with the same results."""

    core: Core
    context: Context
