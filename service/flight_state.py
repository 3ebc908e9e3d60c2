"""What a vehicle says of its flight: armed or not, and in which mode."""

from drivers.events import Heartbeat, ModeChange
from drivers.mavlink.constants import mode_name


class FlightState:
    """The latest of heartbeats, or of the mode changes of a log that has none."""

    def __init__(self) -> None:
        self.is_armed: bool | None = None
        self._heartbeat: Heartbeat | None = None
        self._number: int | None = None

    def take(self, event: Heartbeat | ModeChange) -> None:
        """Note what an event reports; most report a part."""
        if isinstance(event, Heartbeat):
            self._heartbeat = event
        if event.is_armed is not None:
            self.is_armed = event.is_armed
        if event.custom_mode is not None:
            self._number = event.custom_mode

    @property
    def mode(self) -> str:
        """The flight mode's name, empty before it is known."""
        if self._number is None:
            return ""
        beat = self._heartbeat
        kind = (None, None) if beat is None else (beat.autopilot, beat.vehicle_type)
        return mode_name(*kind, self._number)
