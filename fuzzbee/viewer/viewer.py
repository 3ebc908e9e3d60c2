"""The Rerun viewer as a sink: bodies in one place, curves, states and messages."""

from collections.abc import Sequence

from drivers.events import VehicleId
from fuzzbee.viewer import layout
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream
from fuzzbee.viewer.track import Track
from service.records import AttitudeRecord, Departed, Message, Output, Peer, Published, vehicle_name

MOST_VEHICLES = 9  # drawn side by side; more cannot be read
FLUSH_US = 60_000_000  # between two batches of points into a file


class ViewerSink(ViewerStream):
    """Draws what the service publishes.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    name = "viewer"

    def __init__(self, options: ViewerOptions) -> None:
        super().__init__(options, layout.blueprint())
        self._is_live = options.live
        self._tracks: dict[VehicleId, Track] = {}
        self._has_left_out = False
        self._now_us = 0
        self._flushed_us = 0

    def handle(self, outputs: Sequence[Output]) -> None:
        """Take the outputs of one turn, and draw them once enough have come.

        Raises:
            ConnectionError: once, if the viewer has been closed.
            NotWholeError: once, if the file cannot be written any more.
        """
        self.require_whole()
        if self.take_loss():
            raise ConnectionError(CLOSED)
        if not self.is_wanted:
            return
        for output in outputs:
            match output:
                case Published():
                    self._take_published(output)
                case Peer(vehicle=vehicle) if vehicle in self._tracks:
                    self._tracks[vehicle].take_peer(output)
                case Departed(vehicle=vehicle) if vehicle in self._tracks:
                    del self._tracks[vehicle]
                case Message(text=text) if self._now_us:  # before the first record there is no time
                    self.message(text, self._now_us)
        if not 0 <= self._now_us - self._flushed_us < FLUSH_US:
            self._flushed_us = self._now_us
            self.flush()

    def _take_published(self, output: Published) -> None:
        record = output.record
        time_us = record.time_unix_us if isinstance(record, AttitudeRecord) else output.time_unix_us
        self._now_us = time_us or self._now_us
        track = self._track(output.vehicle) if self._now_us else None
        if track is None:
            return
        self._flushed_us = self._flushed_us or self._now_us
        if isinstance(record, AttitudeRecord):
            track.take_attitude(record, output.sample)
        else:
            track.take_status(record, self._now_us)

    def _track(self, vehicle: VehicleId) -> Track | None:
        """The vehicle's track; a new vehicle gets one as long as there is room."""
        taken = {track.place for track in self._tracks.values()}
        free = next((place for place in range(MOST_VEHICLES) if place not in taken), None)
        if vehicle not in self._tracks and free is not None:
            self._tracks[vehicle] = Track(vehicle_name(vehicle), free, self, self._is_live)
        elif vehicle not in self._tracks and not self._has_left_out:
            self._has_left_out = True
            self.message(f"only the first {MOST_VEHICLES} vehicles are drawn", self._now_us)
        return self._tracks.get(vehicle)
