"""A telemetry log whose vehicle carries iron."""

import numpy as np

from tests.fuzzbee.tlogs import rewritten


def with_iron(log, made, offset_mgauss, matrix=None, left_out=(), current_mgauss_a=None):
    """A copy of a log in which every RAW_IMU's field m is matrix^-1 m + offset.

    Messages of the types ``left_out`` are not in it. With ``current_mgauss_a`` its SYS_STATUS say a
    current that rises and falls by 10 to 30 A, slower than messages of a few hertz can follow; it
    adds so much to the field for each ampere.
    """
    back = np.linalg.inv(np.eye(3) if matrix is None else matrix)
    mgauss_a = np.zeros(3) if current_mgauss_a is None else np.array(current_mgauss_a)

    def change(seconds, m):
        ampere, kind = 20.0 + 10.0 * np.sin(seconds / 7.0), m.get_type()
        if kind in left_out:
            return []
        if kind == "RAW_IMU":
            field = back @ (m.xmag, m.ymag, m.zmag) + offset_mgauss + ampere * mgauss_a
            m.xmag, m.ymag, m.zmag = (round(each) for each in field)
        elif kind == "SYS_STATUS" and current_mgauss_a is not None:
            m.current_battery = round(100.0 * ampere)
        else:
            return None
        return [m]

    return rewritten(log, made, change)
