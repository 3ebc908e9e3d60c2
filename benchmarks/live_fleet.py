# ruff: noqa: D102 - what each method does is written at Transport
"""The vehicles of the live benchmark, as a process: ``live_fleet.py PORT VEHICLES HZ SECONDS OUT``.

The simulated vehicles of ``fuzzbee sim``, on UDP; beside it, OUT (.npy) gets the sender and the
Unix time in ns of every datagram, taken right before it was sent.
"""

import sys
import time
from array import array

import numpy as np

from drivers.endpoint import parse_endpoint
from drivers.mavlink.transports.open import open_transport
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet, run_vehicles

# where a MAVLink 2 header has them
SYSTEM_ID, COMPONENT_ID = 5, 6


class NotingTransport:
    """A transport that notes whose datagram left when."""

    def __init__(self, port: int) -> None:
        self._transport = open_transport(parse_endpoint(f"udpout:127.0.0.1:{port}"))
        self.open, self.close = self._transport.open, self._transport.close
        self.receive = self._transport.receive
        self.sent = array("q")

    @property
    def connected(self) -> bool:
        return self._transport.connected

    @property
    def address(self) -> str:
        return self._transport.address

    def send(self, data: bytes) -> None:
        self.sent.append(1000 * (data[COMPONENT_ID] - 1) + data[SYSTEM_ID])
        self.sent.append(time.time_ns())
        self._transport.send(data)


def main() -> None:
    port, vehicles, rate_hz, seconds, out = sys.argv[1:]
    fleet = Fleet(VehicleOptions(rate_hz=float(rate_hz)), int(vehicles))
    transport = NotingTransport(int(port))
    transport.open()
    run_vehicles(fleet, transport, lambda: False, float(seconds))
    np.save(out, np.array(transport.sent, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
