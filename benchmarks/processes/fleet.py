"""The vehicles of the live benchmark: ``fleet.py PORT VEHICLES HZ SECONDS OUT [FEW FROM TO]``.

The simulated vehicles of ``fuzzbee sim``, on UDP; beside it, OUT (.npy) gets the sender and the
Unix time in ns of every datagram, taken right before it was sent. With FEW only so many send, but
for the time FROM to TO, in s since the start.
"""

import sys
import time
from array import array
from typing import Any

import numpy as np

from drivers.endpoint import parse_endpoint
from drivers.mavlink.transports.open import open_transport
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet, run_vehicles

# where a MAVLink 2 header has them
SYSTEM_ID, COMPONENT_ID = 5, 6


class NotingTransport:
    """A transport that notes whose datagram left when."""

    def __init__(self, port: int, few: int, burst_s: tuple[float, float]) -> None:
        self._few = few
        self._burst_s = burst_s
        self._start_s = time.monotonic()
        self._transport = open_transport(parse_endpoint(f"udpout:127.0.0.1:{port}"))
        self.sent = array("q")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def send(self, data: bytes) -> None:
        """Note the time, and send, if this vehicle does now."""
        vehicle = 1000 * (data[COMPONENT_ID] - 1) + data[SYSTEM_ID]
        begin_s, end_s = self._burst_s
        if vehicle > self._few and not begin_s <= time.monotonic() - self._start_s < end_s:
            return
        self.sent.append(vehicle)
        self.sent.append(time.time_ns())
        self._transport.send(data)


def main() -> None:
    port, vehicles, rate_hz, seconds, out, *burst = sys.argv[1:]
    few, *burst_s = map(float, burst or ("1e9", "0", "0"))
    fleet = Fleet(VehicleOptions(rate_hz=float(rate_hz)), int(vehicles))
    transport = NotingTransport(int(port), int(few), (burst_s[0], burst_s[1]))
    transport.open()
    run_vehicles(fleet, transport, lambda: False, float(seconds))
    np.save(out, np.array(transport.sent, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
