"""pymavlink's message definitions, and its unpacking of one message."""

import os
from typing import Any


def mavlink() -> Any:
    """Import pymavlink's ardupilotmega dialect (it includes common), late: it takes 40 ms."""
    os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
    os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega


class Unpacker:
    """Makes pymavlink's messages of frames that are known to be whole and sound."""

    def __init__(self) -> None:
        self._dialect = mavlink()
        self._mav = self._dialect.MAVLink(None)

    def message(self, data: bytes) -> Any | None:
        """The message of exactly one frame, with its fields as attributes; None if it is none."""
        try:
            return self._mav.decode(bytearray(data))
        except self._dialect.MAVError:
            return None
