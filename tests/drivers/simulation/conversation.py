"""What the tests of the simulated vehicles say and read, by pymavlink."""

from drivers.mavlink.constants import mavlink
from tests.drivers.mavlink.pymavlink_parser import PymavlinkParser

SECOND = 1_000_000
UNIX_US = 1_790_000_000_000_000


def parsed(data):
    return PymavlinkParser().feed(data)


def message(kind, *fields, system=255, component=190):
    """A message as another program sends it, after a trip through bytes."""
    dialect = mavlink()
    sender = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    (read,) = parsed(getattr(dialect, f"MAVLink_{kind}_message")(*fields).pack(sender))
    return read


def interval(message_id, interval_us, target=(1, 1)):
    return message("command_long", *target, 511, 0, message_id, interval_us, 0, 0, 0, 0, 0)


def of_type(messages, kind):
    return [m for m in messages if m.get_type() == kind]
