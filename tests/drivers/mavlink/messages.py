"""Messages by pymavlink, through real bytes into our decoder."""

from drivers.events import VehicleId
from drivers.mavlink.constants import mavlink
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader

S = 1_000_000
UNIX = 1_700_000_000 * S
VEHICLE = VehicleId(1, 1)
ARDUPILOT, PX4, GENERIC = 3, 12, 0
G = 9.80665
m = mavlink()


def frame(message, system=1, component=1, force_mavlink1=False, sender=None):
    sender = sender or m.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(message.pack(sender, force_mavlink1=force_mavlink1))


def decode_all(messages, decoder=None, interval_us=20_000, **address):
    """The events of messages that arrive at a steady pace, all through real bytes."""
    decoder, reader, events = decoder or MavlinkDecoder(), FrameReader(), []
    for k, message in enumerate(messages):
        (each,) = reader.feed(frame(message, **address))
        events += decoder.events(each, UNIX + interval_us * k)
    return events


def heartbeat(autopilot=ARDUPILOT, kind=2):
    return m.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)


def raw_imu(time_us=S, acc=(0, 0, -1000), gyr=(0, 0, 0), mag=(200, 0, 400)):
    return m.MAVLink_raw_imu_message(time_us, *acc, *gyr, *mag)


def highres(time_us=S, acc=(0.0, 0.0, -G), gyr=(0.0, 0.0, 0.0), mag=(0.2, 0.0, 0.4), updated=0):
    return m.MAVLink_highres_imu_message(time_us, *acc, *gyr, *mag, 1e3, 0, 0, 20, updated)


def only(kind, events):
    return [event for event in events if isinstance(event, kind)]


class PymavlinkParser:
    """pymavlink's own parser: bytes of one stream in, messages out, what is unreadable left out."""

    def __init__(self):
        self._mav = m.MAVLink(None)
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
