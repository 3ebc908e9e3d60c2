"""Simulated vehicles as a MAVLink process of their own.

:class:`Fleet` holds any number of them, :func:`run_vehicles` plays them on one
link, on an absolute schedule. Their streams are spread over the sample interval,
so that hundreds of vehicles do not send in one burst.
"""

import heapq
import time
from collections.abc import Callable
from math import inf

from drivers.events import LinkUp
from drivers.mavlink.connection import Connection
from drivers.mavlink.framing import FrameReader, parsed
from drivers.mavlink.transports.transport import unix_us
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions
from estimator.errors import InputError

SYSTEMS = 250  # MAVLink system ids end at 255, and ground stations use the last
MOST_VEHICLES = 1000  # those above 250 are the systems' second to fourth components
LONGEST_BACKLOG_US = 1_000_000  # after a longer stall the vehicle goes on with the present
MOST_PEERS = 64  # whose half frames are kept
RECEIVE_S = 0.1  # how often the process looks whether it should end


class Fleet:
    """Vehicles 1..N on one transport; after 250 of them 1-2, 2-2 and so on.

    It counts ``bytes_sent``.

    Raises:
        InputError: an option or the number of vehicles is out of its range.
    """

    def __init__(self, options: VehicleOptions, vehicles: int) -> None:
        if not 1 <= vehicles <= MOST_VEHICLES:
            raise InputError(f"the number of vehicles must be 1 to {MOST_VEHICLES}, not {vehicles}")
        self._vehicles = [
            SimulatedAutopilot(options, i % SYSTEMS + 1, i // SYSTEMS + 1) for i in range(vehicles)
        ]
        self._spread_us = 1e6 / options.rate_hz / vehicles  # over one sample interval
        self._schedule()
        self._readers: dict[str, FrameReader] = {}
        self.bytes_sent = 0

    @property
    def due_us(self) -> float:
        """When, after the start, the next vehicle has something to send."""
        return self._due[0][0]

    def send_due(self, now_us: float, signed_us: int, send: Callable[[bytes], None]) -> None:
        """Send what is due ``now_us`` after the start, one datagram a vehicle and sample."""
        while self._due[0][0] <= now_us:
            due_us, i = self._due[0]
            vehicle, offset_us = self._vehicles[i], i * self._spread_us
            if now_us - due_us > LONGEST_BACKLOG_US:
                vehicle.skip(now_us - offset_us)
            data = vehicle.advance(vehicle.due_us, signed_us)
            heapq.heapreplace(self._due, (vehicle.due_us + offset_us, i))
            if data:
                self.bytes_sent += len(data)
                send(data)

    def receive(
        self, peer: str, data: bytes, signed_us: int, send: Callable[[bytes], None]
    ) -> None:
        """Answer bytes that came from ``peer``; no bytes mean that it has left."""
        if not data:
            self._readers.pop(peer, None)
            return
        if peer not in self._readers and len(self._readers) >= MOST_PEERS:
            self._readers.clear()  # half a frame of somebody long gone is no loss
        answered = False
        for frame in self._readers.setdefault(peer, FrameReader()).feed(data):
            message = parsed(frame.data)
            for vehicle in self._vehicles:
                if answer := vehicle.handle(message, signed_us):
                    answered = True
                    send(answer)
        if answered:  # a changed rate changes what is due
            self._schedule()

    def _schedule(self) -> None:
        numbered = enumerate(self._vehicles)
        self._due = [(each.due_us + i * self._spread_us, i) for i, each in numbered]
        heapq.heapify(self._due)


def run_vehicles(
    fleet: Fleet,
    connection: Connection,
    stopped: Callable[[], bool],
    seconds: float | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> None:
    """Play ``fleet`` on an open connection until ``stopped()`` or for ``seconds``.

    A link that breaks is made again; the vehicles' time goes on meanwhile.
    """
    start_s, end_us = time.monotonic(), inf if seconds is None else seconds * 1e6
    try:
        while not stopped() and (now_us := 1e6 * (time.monotonic() - start_s)) < end_us:
            fleet.send_due(now_us, unix_us(), connection.send)
            wait_us = min(fleet.due_us, end_us) - 1e6 * (time.monotonic() - start_s)
            for packet in connection.receive(min(RECEIVE_S, max(0.0, wait_us * 1e-6))):
                fleet.receive(packet.peer, packet.data, unix_us(), connection.send)
            came_up = any(isinstance(event, LinkUp) for event in connection.take_events())
            if came_up and connection.breaks:
                report("connected")
    finally:
        connection.close()
