"""What a vehicle's parameters and heartbeats say about its sensors, passed on to the estimator."""

from math import pi, sqrt

from drivers.events import COMPASS_CALIBRATED, Heartbeat, Parameter
from drivers.mavlink.ardupilot import (
    ACC_FILTER,
    COMPASS_OFFSETS,
    GYRO_FILTER,
    PX4_COMPASS_OFFSETS,
    ROVER_FILTERS_HZ,
)
from drivers.mavlink.attitude_view import NAMES as VIEW_PARAMETERS
from drivers.mavlink.attitude_view import AttitudeView
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_ARDUPILOTMEGA,
    MAV_TYPE_GENERIC,
    MAV_TYPE_GROUND_ROVER,
)
from estimator.estimator import Estimator
from estimator.vehicle_class import VehicleClass

# A second-order Butterworth low-pass delays slow motions by this many periods of its cutoff.
BUTTERWORTH_DELAY = 1.0 / (sqrt(2.0) * pi)


def vehicle_class_of(heartbeat: Heartbeat) -> VehicleClass:
    """What carries the IMU: anything may be done to a vehicle that is not armed."""
    if heartbeat.vehicle_type == MAV_TYPE_GROUND_ROVER:
        return VehicleClass.WHEELS
    is_vehicle = heartbeat.is_armed is not False and heartbeat.vehicle_type != MAV_TYPE_GENERIC
    return VehicleClass.VEHICLE if is_vehicle else VehicleClass.ANYTHING


class VehicleParameters:
    """Parameters of one vehicle that matter to its attitude."""

    def __init__(self) -> None:
        self._heartbeat: Heartbeat | None = None  # the last one that brought something new
        self.view = AttitudeView()  # of what the autopilot's attitude is
        self._compass_offsets: dict[str, float] = {}
        self._filters_hz: dict[str, float] = {}

    def take(self, event: Parameter, estimator: Estimator) -> None:
        """Note compass offsets (all zero: nobody has calibrated it), the trim and filters."""
        if event.name in VIEW_PARAMETERS:
            self.view.take(event.name, event.value)
        elif event.name in (GYRO_FILTER, ACC_FILTER) and event.value > 0.0:
            self._note_filter(event.name, event.value, estimator)
        elif event.name == COMPASS_CALIBRATED:
            estimator.set_field_calibrated(bool(event.value))
        elif event.name in (*COMPASS_OFFSETS, *PX4_COMPASS_OFFSETS):
            self._compass_offsets[event.name] = event.value
            if len(self._compass_offsets) == len(COMPASS_OFFSETS):
                estimator.set_field_calibrated(any(self._compass_offsets.values()))

    def is_repeated(self, event: Heartbeat) -> bool:
        """Whether a heartbeat brings nothing new."""
        known = self._heartbeat
        return known is not None and (
            (known.autopilot, known.vehicle_type, known.is_armed)
            == (event.autopilot, event.vehicle_type, event.is_armed)
        )

    def take_heartbeat(self, event: Heartbeat, estimator: Estimator) -> None:
        """Note what carries the IMU, and the filters that ArduPilot gives such a vehicle."""
        self._heartbeat = event
        self.view.vehicle_type = event.vehicle_type
        vehicle_class = vehicle_class_of(event)
        estimator.set_vehicle_class(vehicle_class)
        if vehicle_class is VehicleClass.WHEELS and event.autopilot == MAV_AUTOPILOT_ARDUPILOTMEGA:
            for name, cutoff_hz in ROVER_FILTERS_HZ.items():
                self._note_filter(name, self._filters_hz.get(name, cutoff_hz), estimator)

    def _note_filter(self, name: str, cutoff_hz: float, estimator: Estimator) -> None:
        """Tell the estimator what low-passes delay; heard again it takes back nothing learnt."""
        known = self._filters_hz
        if known.get(name) == cutoff_hz:
            return
        known[name] = cutoff_hz
        gyr_hz = known.get(GYRO_FILTER)
        if gyr_hz is not None:
            acc_hz = known.get(ACC_FILTER, gyr_hz)
            estimator.set_imu_lag(BUTTERWORTH_DELAY / gyr_hz, BUTTERWORTH_DELAY / acc_hz)
