"""How long the vehicles of a killed worker are without an attitude, with real processes.

python benchmarks/live_deaths.py [--vehicles N] [--workers N] [--rate HZ] [--deaths N] [--nursery]
    [--json]

Simulated vehicles send over UDP on loopback to ``fuzzbee run --workers N``; a subscriber in this
process notes each attitude. Every few seconds a worker is killed (SIGKILL); ``gap`` is from that
moment to the callback with the first attitude made afterwards, of each vehicle that the worker had.
``steps`` are how often a vehicle's sequence did not go on by one meanwhile. With ``--nursery`` the
process that workers come from is killed right before, once, so that all is loaded anew. ``memory``
is what the processes have to themselves, and their parts of what they share (PSS), in MB.
"""

import argparse
import json
import os
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from live import children, family, free_port, pss_mb, start, start_service
from live_floor import percentiles
from live_subscriber import client

SETTLE_S = 4.0  # before each death
LONGEST_S = 10.0
DESCRIPTION = __doc__.splitlines()[0]


class Seen(msgspec.Struct):
    """What is looked at of an attitude."""

    time_unix_us: int
    sequence: int


class Status(msgspec.Struct):
    """What is looked at of a status."""

    worker: int
    restarts: int


class Notes:
    """Arrival (s), time of the tick (s) and sequence of each vehicle's attitudes; their workers."""

    def __init__(self) -> None:
        self.attitudes: defaultdict[str, list[tuple[float, float, int]]] = defaultdict(list)
        self.workers: dict[str, int] = {}
        self.restarts = 0
        self._lock = threading.Lock()

    def on_attitude(self, sample: Any) -> None:
        """Called by Zenoh."""
        seen = msgspec.json.decode(sample.payload.to_bytes(), type=Seen)
        row = (time.time(), 1e-6 * seen.time_unix_us, seen.sequence)
        self.attitudes[str(sample.key_expr).split("/")[1]].append(row)

    def on_status(self, sample: Any) -> None:
        """Called by Zenoh."""
        status = msgspec.json.decode(sample.payload.to_bytes(), type=Status)
        self.workers[str(sample.key_expr).split("/")[1]] = status.worker
        self.restarts = max(self.restarts, status.restarts)


def main() -> None:
    options = _options()
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    service = start_service(port, endpoint, options.rate, workers=options.workers)
    seconds = (SETTLE_S + 3.0) * (options.deaths + 1)
    shape = (str(port), str(options.vehicles), str(options.rate), str(seconds))
    notes, gaps = Notes(), []
    with tempfile.TemporaryDirectory() as folder, client(endpoint) as session:
        session.declare_subscriber("fuzzbee/*/attitude", notes.on_attitude)
        session.declare_subscriber("fuzzbee/*/status", notes.on_status)
        fleet = start("live_fleet.py", *shape, str(Path(folder, "sent.npy")))
        memory = {}
        for number in range(options.deaths):
            time.sleep(SETTLE_S)
            memory = memory or {
                str(pid): pss_mb(pid) for pid in [service.pid, *family(service.pid)]
            }
            gaps += killed(service.pid, notes, number % options.workers, options.nursery)
        fleet.kill()
        fleet.communicate()
    service.send_signal(signal.SIGINT)
    service.communicate(timeout=10)
    steps = sum(
        int((np.diff([row[2] for row in rows]) != 1).sum()) for rows in notes.attitudes.values()
    )
    result = {
        "vehicles": options.vehicles,
        "workers": options.workers,
        "rate_hz": options.rate,
        "deaths": options.deaths,
        "restarts": notes.restarts,
        "gap": percentiles(np.array(gaps) * 1e3),
        "worst_gap_s": round(max(gaps), 3),
        "steps": steps,
        "memory": memory,
    }
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


def killed(service: int, notes: Notes, worker: int, with_nursery: bool) -> list[float]:
    """Kill a worker; the gaps of its vehicles, in s."""
    nursery = children(service)[-1]
    victim = children(nursery)[worker]
    before = dict(notes.workers)
    if with_nursery:
        os.kill(nursery, signal.SIGKILL)
    at_s = time.time()
    os.kill(victim, signal.SIGKILL)
    end_s = at_s + LONGEST_S
    first: dict[str, float] = {}
    while time.time() < end_s and len(first) < len(before):
        for name in before:
            if name not in first:
                later = [row[0] for row in notes.attitudes[name][-200:] if row[1] > at_s]
                if later:
                    first[name] = later[0] - at_s
        time.sleep(0.002)
    longest = max(first.values())
    number = max(before, key=lambda name: first.get(name, LONGEST_S))
    theirs = [name for name, of in before.items() if of == before[number]]
    print(f"{len(theirs)} vehicles of worker {before[number]}: {longest:.3f} s", file=sys.stderr)
    return [first.get(name, LONGEST_S) for name in theirs]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=DESCRIPTION)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--deaths", type=int, default=4)
    parser.add_argument("--nursery", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.nursery:
        options.deaths = 1  # afterwards the workers are nobody's children
    return options


if __name__ == "__main__":
    main()
