"""Vehicles for live.py: ``fleet.py PORT VEHICLES HZ SECONDS OUT [FEW FROM TO]``.

The simulated vehicles of ``fuzzbee sim``, on UDP: all is made before they begin, so that to
send it costs little. OUT (.npy) gets the sender and the Unix time in ns of every sample's
datagram, taken right before it was sent.
With FEW only so many send, but for the time FROM to TO, in s since the start.
"""

import gc
import socket
import sys
import time
from array import array
from contextlib import suppress

import numpy as np

from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet

SYSTEM, COMPONENT = 5, 6  # where a MAVLink 2 frame has its sender
LATE_S = 0.001  # a datagram leaves this late at most, where there is time


def datagrams(options: VehicleOptions, vehicles: int, seconds: float) -> list[tuple[float, bytes]]:
    """All that vehicles send, and when; each datagram has a sample."""
    fleet, packets = Fleet(options, vehicles), []
    while fleet.due_us <= seconds * 1e6:
        due_us = fleet.due_us
        fleet.send_due(due_us, 0, lambda data, due_us=due_us: packets.append((due_us, data)))
    return packets


def main() -> None:
    port, vehicles, rate_hz, seconds, out, *burst = sys.argv[1:]
    few, *burst_s = map(float, burst or ("1e9", "0", "0"))
    packets = datagrams(VehicleOptions(rate_hz=float(rate_hz)), int(vehicles), float(seconds))
    gc.freeze()
    print("ready", flush=True)
    sys.stdin.readline()
    sent, start_ns = array("q"), time.time_ns()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", int(port)))
        for due_us, data in packets:
            vehicle = 1000 * (data[COMPONENT] - 1) + data[SYSTEM]
            if vehicle > few and not burst_s[0] <= 1e-6 * due_us < burst_s[1]:
                continue
            wait_s = 1e-6 * due_us - 1e-9 * (time.time_ns() - start_ns)
            if wait_s > LATE_S:
                time.sleep(wait_s)
            sent.extend((vehicle, time.time_ns()))
            with suppress(ConnectionRefusedError):  # the listener is gone
                wire.send(data)
    np.save(out, np.array(sent, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
