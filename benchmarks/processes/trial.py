"""Simulated vehicles, a service and a subscriber as real processes, and what came of them."""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common.report import Row

from tests.fuzzbee.processes import free_port

HERE = Path(__file__).parent
WARM_UP_S = 2.0  # vehicles appear and estimators align; records of this time are not timed
SETTLE_S = 0.5
Process = subprocess.Popen[str]
# Starts a service on a UDP port and a Zenoh endpoint, at a rate of publishing in Hz.
BeginService = Callable[[int, str, float], Process]


class Shape(NamedTuple):
    """How many vehicles send at what rate for how long, and at what rate is published.

    Only ``few`` of them send all the time, the others from ``burst_s[0]`` to ``burst_s[1]``.
    """

    vehicles: int
    rate_hz: float
    seconds: float
    publish_hz: float
    few: int = 10**9
    burst_s: tuple[float, float] = (0.0, 0.0)


class Seen(NamedTuple):
    """What the processes wrote down.

    ``sent`` (N, 2): vehicle and Unix time in ns of each datagram; ``attitudes`` (M, 5): vehicle,
    Unix time of the callback in ns, time of the tick in us, age of its sample in us, sequence.
    """

    sent: np.ndarray
    attitudes: np.ndarray
    summary: dict[str, Any]
    start_ns: int


def run(
    shape: Shape,
    begin_service: BeginService,
    meanwhile: Callable[[Process, list[int]], None],
) -> Seen:
    """One run; ``meanwhile`` gets the service, and the subscriber's and the fleet's process id."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        sent, seen = Path(folder, "sent.npy"), Path(folder, "seen.npy")
        numbers = (port, shape.vehicles, shape.rate_hz, shape.seconds, sent)
        fleet = start("fleet.py", *map(str, (*numbers, shape.few, *shape.burst_s)))
        service = begin_service(port, endpoint, shape.publish_hz)
        # nothing else reads it, and a pipe that is full would stop the service
        threading.Thread(target=service.stderr.read, daemon=True).start()  # type: ignore[union-attr]
        subscriber = start("subscriber.py", endpoint, str(seen))
        assert fleet.stdin is not None
        print(file=fleet.stdin, flush=True)
        start_ns = time.time_ns()
        meanwhile(service, [subscriber.pid, fleet.pid])
        fleet.wait()
        time.sleep(SETTLE_S)
        subscriber.communicate()
        service.send_signal(signal.SIGINT)
        assert service.stdout is not None
        summary = json.loads(service.stdout.read())
        service.wait()
        if fleet.returncode:
            raise SystemExit("the vehicles ended early")
        return Seen(np.load(sent), np.load(seen), summary, start_ns)


def start(script: str, *arguments: str) -> Process:
    """A process of the benchmark that is ready."""
    return _begun([str(HERE / script), *arguments], "ready", stdin=subprocess.PIPE)


def fuzzbee(port: int, endpoint: str, publish_hz: float, *options: str) -> Process:
    """``fuzzbee run`` on that UDP port, connected to nobody but at ``endpoint``."""
    # the address is both: nobody else's session is looked for
    zenoh_options = ["-l", endpoint, "-e", endpoint]
    command = ["-m", "fuzzbee", "run", f"udpin:127.0.0.1:{port}", "--json"]
    command += ["--rate", str(publish_hz), *zenoh_options, *options]
    return _begun(command, "listening", stderr=subprocess.PIPE)


def plain(port: int, endpoint: str, publish_hz: float) -> Process:
    """The plain script in the service's place."""
    command = [str(HERE / "plain.py"), str(port), endpoint, str(publish_hz)]
    return _begun(command, "listening", stderr=subprocess.PIPE)


def _begun(arguments: list[str], word: str, **pipes: int) -> Process:
    """A Python process, once it has said that word on its standard error, or else output."""
    pipes |= {"stdout": subprocess.PIPE}
    environment, command = {**os.environ, "COLUMNS": "500"}, [sys.executable, *arguments]
    process = subprocess.Popen(command, text=True, env=environment, **pipes)  # noqa: S603
    lines = []
    for line in process.stderr or process.stdout or ():
        lines.append(line.strip())
        if word in line:
            return process
    raise SystemExit(f"a process ended early: {lines}")


def figures(seen: Seen, window_ns: tuple[int, int], publish_hz: float) -> Row:
    """Rates, gaps and latencies (ms: median, 99th percentile, worst) within a time."""
    begin_ns, end_ns = window_ns
    all_of_it = seen.attitudes
    timed = all_of_it[(all_of_it[:, 1] >= begin_ns) & (all_of_it[:, 1] < end_ns)]
    gaps, latency_ms, fresh_ms = 0, [np.empty(0)], [np.empty(0)]
    for vehicle in np.unique(all_of_it[:, 0]):
        gaps += int((np.diff(all_of_it[all_of_it[:, 0] == vehicle, 4]) != 1).sum())
        rows = timed[timed[:, 0] == vehicle]
        if len(rows) < 2:
            continue
        sent_ns = seen.sent[seen.sent[:, 0] == vehicle, 1]
        arrival_ns = (rows[:, 2] - rows[:, 3]) * 1000
        last = np.searchsorted(sent_ns, arrival_ns + 999, side="right") - 1
        ms = (rows[:, 1] - sent_ns[last]) / 1e6
        latency_ms.append(ms)
        fresh_ms.append(ms[1:][np.diff(last) > 0])
    ticks_ms = np.unique(timed[:, 2]) / 1e3
    period_ms = 1e3 / publish_hz
    phase_ms = ticks_ms % period_ms
    counts, edges = np.histogram(phase_ms, bins=200, range=(0.0, period_ms))
    late_ms = (phase_ms - edges[counts.argmax()]) % period_ms
    return {
        "attitudes/s": round(len(timed) / (end_ns - begin_ns) * 1e9, 1),
        "sequence gaps": gaps,
        "sample to subscriber": percentiles(np.concatenate(latency_ms)),
        "new sample to subscriber": percentiles(np.concatenate(fresh_ms)),
        "age at tick": percentiles(timed[:, 3] / 1e3),
        "tick late": percentiles(late_ms),
        "ticks apart": percentiles(np.diff(ticks_ms)),
    }


def percentiles(values_ms: np.ndarray) -> list[float] | None:
    """Median, 99th percentile and worst."""
    if not len(values_ms):
        return None
    return [round(float(each), 3) for each in np.percentile(values_ms, (50, 99, 100))]


def counts(seen: Seen) -> Row:
    """What became of the samples, in all."""
    vehicles, departed = seen.summary["vehicles"].values(), seen.summary.get("departed", {})
    taken = sum(each["samples"] + sum(each["rejected"].values()) for each in vehicles)
    taken += departed.get("samples", 0) + departed.get("rejected", 0)
    shed = sum(each.get("shed", 0) for each in vehicles) + departed.get("shed", 0)
    lost = seen.summary.get("lost", 0)
    return {
        "sent": len(seen.sent),
        "taken": taken,
        "shed": shed,
        "lost": lost,
        "uncounted": len(seen.sent) - taken - shed - lost,
        "overruns": seen.summary["overruns"],
        "dropped": seen.summary["dropped"],
        "load average": round(os.getloadavg()[0], 2),
    }
