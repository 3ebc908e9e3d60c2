"""Telemetry logs with other messages in them, and tables."""

from drivers.logs.log_file import Window
from drivers.logs.tlog import tlog_records
from drivers.mavlink.constants import mavlink
from drivers.mavlink.framing import parsed


def table(path, rate_hz, rows, columns=()):
    """A table of rows (gyroscope, accelerometer, other columns) at times."""
    heading = ["time_s", "gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_g", "ay_g", "az_g", *columns]
    lines = [",".join(map(str, (k / rate_hz, *row))) for k, row in enumerate(rows) if row]
    path.write_text("\n".join([",".join(heading), *lines]))
    return path


def rewritten(log, made, change):
    """A copy of a log with the messages that ``change(seconds, message)`` gives for each message.

    None leaves it as it is. Seconds count from the first stamp; others have its address and number.
    """
    data, first_us = bytearray(), None
    for stamp_us, frame in filter(None, tlog_records(Window(log.read_bytes()))):
        first_us = stamp_us if first_us is None else first_us
        message = parsed(frame.data)
        given = change(1e-6 * (stamp_us - first_us), message)
        frames = [frame.data]
        if given is not None:
            link = mavlink().MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
            link.seq = message.get_seq()
            frames = [each.pack(link) for each in given]
        for each in frames:
            data += stamp_us.to_bytes(8, "big") + bytes(each)
    made.write_bytes(data)
    return made
