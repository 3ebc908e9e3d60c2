"""What a vehicle's parameters and heartbeats report, of its sensors and of its flight."""

from math import pi, sqrt

from drivers.events import COMPASS_CALIBRATED, Heartbeat, ModeChange, Parameter
from drivers.mavlink import ardupilot
from drivers.mavlink import constants as mav
from estimator.estimator import Estimator
from estimator.types import VehicleClass

# A second-order Butterworth low-pass delays slow motions by this many periods of its cutoff.
BUTTERWORTH_DELAY = 1.0 / (sqrt(2.0) * pi)


class VehicleParameters:
    """Parameters of one vehicle that matter to its attitude, and its flight mode."""

    def __init__(self) -> None:
        self.view = ardupilot.AttitudeView()  # of what the autopilot's attitude is
        self.is_armed: bool | None = None
        self._mode: int | None = None
        # autopilot, vehicle type, and whether it is armed
        self._last_heartbeat: tuple[int | None, int | None, bool | None] = (None, None, None)
        self._compass_offsets: dict[str, float] = {}
        self._filters_hz: dict[str, float] = {}

    @property
    def mode(self) -> str:
        """The flight mode's name, empty before it is known."""
        return "" if self._mode is None else mav.mode_name(*self._last_heartbeat[:2], self._mode)

    def take_mode(self, event: Heartbeat | ModeChange) -> None:
        """Note what an event reports of the flight; most report a part."""
        if event.is_armed is not None:
            self.is_armed = event.is_armed
        if event.custom_mode is not None:
            self._mode = event.custom_mode

    def take(self, event: Parameter, estimator: Estimator) -> None:
        """Note compass offsets (all zero: not calibrated), the trim and filters."""
        if event.name in ardupilot.VIEW_PARAMETERS:
            self.view.take(event.name, event.value)
        elif event.name in (ardupilot.GYRO_FILTER, ardupilot.ACC_FILTER) and event.value > 0.0:
            self._note_filter(event.name, event.value, estimator)
        elif event.name == COMPASS_CALIBRATED:
            estimator.set_field_calibrated(bool(event.value))
        elif event.name in (*ardupilot.COMPASS_OFFSETS, *ardupilot.PX4_COMPASS_OFFSETS):
            self._compass_offsets[event.name] = event.value
            if len(self._compass_offsets) == len(ardupilot.COMPASS_OFFSETS):
                estimator.set_field_calibrated(any(self._compass_offsets.values()))

    def take_heartbeat(self, event: Heartbeat, estimator: Estimator) -> None:
        """Note mode, what carries the IMU, and the filters that ArduPilot gives such a vehicle.

        Anything may be done to a vehicle that is not armed.
        """
        self.take_mode(event)
        heartbeat = (event.autopilot, event.vehicle_type, event.is_armed)
        if heartbeat == self._last_heartbeat:
            return
        self._last_heartbeat = heartbeat
        self.view.vehicle_type = event.vehicle_type
        if event.vehicle_type == mav.MAV_TYPE_GROUND_ROVER:
            estimator.set_vehicle_class(VehicleClass.WHEELS)
            if event.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
                for name, cutoff_hz in ardupilot.ROVER_FILTERS_HZ.items():
                    self._note_filter(name, self._filters_hz.get(name, cutoff_hz), estimator)
        elif event.is_armed is False or event.vehicle_type == mav.MAV_TYPE_GENERIC:
            estimator.set_vehicle_class(VehicleClass.ANYTHING)
        else:
            estimator.set_vehicle_class(VehicleClass.VEHICLE)

    def _note_filter(self, name: str, cutoff_hz: float, estimator: Estimator) -> None:
        """Pass on what low-passes delay; a value that is repeated takes back nothing learnt."""
        known = self._filters_hz
        if known.get(name) == cutoff_hz:
            return
        known[name] = cutoff_hz
        gyr_hz = known.get(ardupilot.GYRO_FILTER)
        if gyr_hz is not None:
            acc_hz = known.get(ardupilot.ACC_FILTER, gyr_hz)
            estimator.set_imu_lag(BUTTERWORTH_DELAY / gyr_hz, BUTTERWORTH_DELAY / acc_hz)
