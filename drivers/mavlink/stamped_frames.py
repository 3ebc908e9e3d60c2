"""Records of a tlog from whole datagrams, made by compiled code.

:func:`~drivers.mavlink.recorder.records_of` makes the same of frames, one by one.
"""

from functools import cache
from typing import Any

import numpy as np

from drivers.mavlink.recorder import Records
from drivers.mavlink.scanning import LEFT, SHORTEST, Scanned, header
from drivers.mavlink.transports.datagrams import Datagrams
from estimator.compilation.compiled import compiled
from estimator.compilation.direct import direct, types_of

Array = Any  # numba ships no types
STAMP_BYTES = 8
MESSAGES = 1 << 24  # all that a frame's number may be: its sender is known already


@compiled
def stamp_frames(
    data: Array, begins: Array, ends: Array, arrivals_us: Array, out: Array
) -> tuple[int, int]:
    """Write the frames of datagrams that hold nothing else, each behind its arrival.

    Returns how many bytes and how many frames were written.
    """
    written, frames = 0, 0
    for k in range(len(ends)):
        at = begins[k]
        while at < ends[k]:
            stop = header(data, at, ends[k], MESSAGES)[0]
            if stop < 0:
                break
            for i in range(STAMP_BYTES):
                out[written + i] = arrivals_us[k] >> 8 * (STAMP_BYTES - 1 - i) & 0xFF
            written += STAMP_BYTES
            for i in range(at, stop):
                out[written + i - at] = data[i]
            written += stop - at
            frames, at = frames + 1, stop
    return written, frames


def records_in(scanned: Scanned, which: Array) -> Records:
    """The records of those datagrams, of which an array says so, that hold nothing but frames."""
    come = scanned.datagrams.kept(which & (scanned.counts != LEFT))
    if not come.number:
        return Records(0, b"", 0)
    size = int((come.ends - come.begins).sum())
    out = np.empty(size + STAMP_BYTES * (size // SHORTEST + 1), np.uint8)
    stamp = direct(stamp_frames, argument_types())
    written, frames = stamp(come.data, come.begins, come.ends, come.arrivals_us, out)
    return Records(int(come.arrivals_us[-1]), out[:written].tobytes(), frames)


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`stamp_frames` is called with."""
    none = Datagrams.of([], 0)
    return types_of(*none[:3], none.arrivals_us, np.zeros(0, np.uint8))
