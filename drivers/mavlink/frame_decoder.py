"""Frames to events, decoding only what somebody wants."""

from drivers.events import Event
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.dialect import Unpacker, mavlink
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import imu_message

# Attitudes of others score an estimate afterwards; the live service has no use for them
REFERENCES = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", "SIM_STATE", "SIMSTATE"})


class FrameDecoder:
    """The events of frames, for any number of vehicles.

    ``references`` says whether attitudes of others are wanted; ``wanted`` holds the numbers
    of the messages that are. The IMU messages are unpacked here, the rest by pymavlink.
    """

    def __init__(self, *, references: bool = True) -> None:
        self._decoder = MavlinkDecoder()
        self._unpacker = Unpacker()
        names = self._decoder.message_names
        if not references:
            names -= REFERENCES
        kinds = mavlink().mavlink_map.items()
        self.wanted = frozenset(number for number, kind in kinds if kind.msgname in names)

    def events(self, frame: Frame, arrival_us: int) -> list[Event]:
        """The events in one frame that arrived at ``arrival_us`` (Unix time, us)."""
        if frame.message_id not in self.wanted:
            return []
        imu = imu_message(frame)
        if imu is not None:
            return self._decoder.decode_imu(
                frame.system_id, frame.component_id, *imu, arrival_us=arrival_us
            )
        message = self._unpacker.message(frame.data)
        return [] if message is None else self._decoder.decode(message, arrival_us)
