"""When a log's samples were taken, on the clock of whoever wrote the log."""

import numpy as np

from drivers.logs.table import blocks
from estimator.arrays import Times
from fuzzbee.replays.trace import VehicleTrace
from service.publishing import HostClock

# Stamps before September 2001 count from the vehicle's start: it knew no date.
EARLIEST_UNIX_US = 10**15
# ROS has 31 bits for the seconds, until 2038: a later date is a garbled stamp.
LATEST_UNIX_US = 10**6 << 31


def stamps_us(trace: VehicleTrace) -> Times:
    """Unix time (N,) of the samples, or the time since the first where that is not known."""
    unix_us = unix_times_us(trace)
    return trace["time_us"] - trace.zero_us if unix_us is None else unix_us


def unix_times_us(trace: VehicleTrace) -> Times | None:
    """Unix time (N,) of the samples; None if the log's stamps are no dates.

    A message is stamped when it arrives, now soon, now late: the vehicle's own clock is carried
    over as in the live service. Times never go back.
    """
    times_us, arrivals_us = trace["time_us"], trace["arrival_us"]
    if not len(arrivals_us) or arrivals_us[0] < EARLIEST_UNIX_US:
        return None
    clock, found = HostClock(), np.empty(len(arrivals_us), dtype=np.int64)
    for rows in blocks(len(found)):
        both = zip(times_us[rows].tolist(), arrivals_us[rows].tolist(), strict=True)
        for k, (time_us, arrival_us) in enumerate(both, rows.start):
            clock.observe(time_us, arrival_us)
            found[k] = round(time_us + clock.offset_us)
    return np.maximum.accumulate(found) if found.max() < LATEST_UNIX_US else None
