"""Writes changes that the service made by itself into the recording, beside what arrived.

A STATUSTEXT of the vehicle's system with component 191, as attitudes are sent: whoever replays the
recording sees when it was retuned, and to what.
"""

import time
from collections.abc import Callable, Sequence

from drivers.events import VehicleId
from drivers.mavlink.constants import MAV_COMP_ID_ONBOARD_COMPUTER
from drivers.mavlink.encoder import FrameEncoder, statustext
from drivers.mavlink.recorder import Recorder
from service.records import Output, Replaced

UnixUs = Callable[[], int]


class RecordingSink:
    """Writes a line for each change to ``recorder``, which others write to, too."""

    name = "recording"

    def __init__(
        self, recorder: Recorder, unix_us: UnixUs = lambda: time.time_ns() // 1000
    ) -> None:
        self._recorder = recorder
        self._unix_us = unix_us
        self._encoders: dict[int, FrameEncoder] = {}

    def handle(self, outputs: Sequence[Output]) -> None:
        """Keep the changes among the outputs."""
        for output in outputs:
            if isinstance(output, Replaced) and output.retuned is not None:
                self._write(output.vehicle.system_id, f"retuned: {output.retuned}")

    def close(self) -> None:
        """Do nothing: the recorder is closed by its owner."""

    def _write(self, system_id: int, text: str) -> None:
        sender = VehicleId(system_id, MAV_COMP_ID_ONBOARD_COMPUTER)
        encoder = self._encoders.setdefault(system_id, FrameEncoder(sender))
        now_us = self._unix_us()
        self._recorder.write(now_us, [encoder.frame(statustext(text), now_us)])
