"""pymavlink's own parser, which knows nothing of ours: what ours is compared with."""

from drivers.mavlink.constants import mavlink


class PymavlinkParser:
    """Bytes of one stream in, pymavlink's messages out; what is unreadable is passed over."""

    def __init__(self):
        self._mav = mavlink().MAVLink(None)
        self._mav.robust_parsing = True

    def feed(self, data):
        """Every message completed by ``data``, in order."""
        mav, messages = self._mav, []
        message = mav.parse_char(data)
        while message is not None:
            if message.get_type() == "BAD_DATA":
                self._look_again(bytes(message.data))
            else:
                messages.append(message)
            message = mav.parse_char(b"")
        return messages

    def _look_again(self, data):
        """A damaged length may have swallowed good frames: behind the first byte."""
        if len(data) > 1 and data[0] in (0xFD, 0xFE):
            self._mav.buf = bytearray(data[1:]) + self._mav.buf[self._mav.buf_index :]
            self._mav.buf_index = 0
