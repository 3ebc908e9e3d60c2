"""A telemetry log whose vehicle carries iron."""

import numpy as np

from drivers.mavlink.dialect import mavlink

STAMP_SIZE = 8


def with_iron(log, made, offset_mgauss, matrix=None, left_out=(), current_mgauss_a=None):
    """A copy of a log in which every RAW_IMU's field m is matrix^-1 m + offset.

    Messages of the types ``left_out`` are not in it. With ``current_mgauss_a`` its SYS_STATUS say a
    current that rises and falls by 10 to 30 A, which adds so much to the field for each ampere.
    """
    data, out, at = log.read_bytes(), bytearray(), 0
    mav, back = mavlink().MAVLink(None), np.linalg.inv(np.eye(3) if matrix is None else matrix)
    while at < len(data):
        size = data[at + 9] + (8 if data[at + 8] == 0xFE else 12 + 13 * (data[at + 10] & 1))
        end = at + STAMP_SIZE + size
        frame = data[at + STAMP_SIZE : end]
        (m, *_) = mav.parse_buffer(frame) or (None,)
        if m is not None and m.get_type() == "RAW_IMU":
            field = back @ (m.xmag, m.ymag, m.zmag) + offset_mgauss
            if current_mgauss_a is not None:
                field += ampere(data, at) * np.array(current_mgauss_a)
            m.xmag, m.ymag, m.zmag = (round(each) for each in field)
            sent = mavlink().MAVLink(None, m.get_srcSystem(), m.get_srcComponent())
            sent.seq = m.get_seq()
            frame = m.pack(sent, force_mavlink1=frame[0] == 0xFE)
        elif m is not None and m.get_type() == "SYS_STATUS" and current_mgauss_a is not None:
            m.current_battery = round(100.0 * ampere(data, at))
            sent = mavlink().MAVLink(None, m.get_srcSystem(), m.get_srcComponent())
            sent.seq = m.get_seq()
            frame = m.pack(sent, force_mavlink1=frame[0] == 0xFE)
        if m is None or m.get_type() not in left_out:
            out += data[at : at + STAMP_SIZE] + frame
        at = end
    made.write_bytes(out)
    return made


def ampere(data, at):
    """The current at the time of a record, slower than messages of a few hertz can follow."""
    stamp_us = int.from_bytes(data[at : at + STAMP_SIZE], "big")
    return 20.0 + 10.0 * np.sin(1e-6 * (stamp_us % 2**40) / 7.0)
