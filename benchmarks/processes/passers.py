"""Vehicles that come and go: ``passers.py PORT VEHICLES HZ SECONDS OUT STAY KEY``.

So many at a time on UDP, signed with the key of KEY (a file), each for STAY seconds; the next one
has the next address. OUT (.npy) gets the sender and the Unix time in ns of every datagram.
"""

import socket
import sys
import time
from array import array
from contextlib import suppress
from itertools import count
from pathlib import Path

import numpy as np

from drivers.mavlink.encoder import signing_key
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions

SYSTEMS, COMPONENTS = 250, 150  # addresses that are taken in turn


def main() -> None:
    port, vehicles, rate_hz, seconds, out, stay_s, key = sys.argv[1:]
    options = VehicleOptions(
        rate_hz=float(rate_hz), signing_key=signing_key(Path(key).read_bytes())
    )
    numbers, sent = count(), array("q")
    print("ready", flush=True)
    sys.stdin.readline()
    begun_s = time.monotonic()
    at_once: list[tuple[float, SimulatedAutopilot]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", int(port)))
        while (now_s := time.monotonic() - begun_s) < float(seconds):
            at_once = [each for each in at_once if now_s - each[0] < float(stay_s)]
            wanted = min(int(vehicles), 1 + int(now_s / float(stay_s) * int(vehicles)))
            while len(at_once) < wanted:
                number = next(numbers)
                system, component = number % SYSTEMS + 1, number // SYSTEMS % COMPONENTS + 1
                at_once.append((now_s, SimulatedAutopilot(options, system, component)))
            for come_s, vehicle in at_once:
                address = vehicle.id.system_id << 8 | vehicle.id.component_id
                while vehicle.due_us <= 1e6 * (now_s - come_s):
                    data = vehicle.advance(vehicle.due_us, time.time_ns() // 1000)
                    sent.extend((address, time.time_ns()))
                    with suppress(ConnectionRefusedError):  # nobody listens any more
                        wire.send(data)
            time.sleep(0.5 / options.rate_hz)
    np.save(out, np.array(sent, np.int64).reshape(-1, 2))


if __name__ == "__main__":
    main()
