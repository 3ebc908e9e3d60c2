"""The live service over a long time: memory, file descriptors and threads must not grow.

python benchmarks/soak.py [--samples 2000000] [--vehicles 50] [--rate 100] [--json]

Simulated vehicles over UDP, ``fuzzbee run`` and a subscriber, as in live.py. The vehicles are
started anew a few times: reboots, new UDP ports, silence. Exit status 1 if something grew.
"""

import argparse
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from live import await_word, free_port, start, start_service

ROUND_S = 45.0
PAUSE_S = 1.5
LOOK_S = 1.0
MOST_GROWTH_MB = 5.0  # between the second third and the last: noise of the allocator
PUBLISH_HZ = 10.0


class Look(NamedTuple):
    """The memory, descriptors and threads of a process at one moment."""

    at_s: float
    resident_mb: float
    descriptors: int
    threads: int


def main() -> None:
    options = _options()
    result = soak(options.samples, options.vehicles, options.rate)
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))
    sys.exit(0 if result["flat"] else 1)


def soak(samples: int, vehicles: int, rate_hz: float) -> dict[str, Any]:
    """Fly until that many samples have been sent, and look at the service meanwhile."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    seconds = samples * 1.03 / (vehicles * rate_hz)
    looks: list[Look] = []
    with tempfile.TemporaryDirectory() as folder:
        service = start_service(port, endpoint, PUBLISH_HZ)
        subscriber = start("live_subscriber.py", endpoint, str(Path(folder, "seen.npy")))
        await_word(subscriber.stdout, "ready")
        begin_s, flown_s = time.monotonic(), 0.0
        while flown_s < seconds:
            round_s = min(ROUND_S, seconds - flown_s)
            _fly(port, vehicles, rate_hz, round_s, lambda: looks.append(look(service.pid, begin_s)))
            flown_s += round_s
            time.sleep(PAUSE_S)
        subscriber.communicate()
        service.send_signal(signal.SIGINT)
        summary = json.loads(service.communicate()[0])
    return {
        "samples": sum(vehicle["samples"] for vehicle in summary["vehicles"].values()),
        "vehicles": vehicles,
        "rate_hz": rate_hz,
        "seconds": round(time.monotonic() - begin_s, 1),
        "overruns": summary["overruns"],
        "dropped": summary["dropped"],
        **verdict(looks),
    }


def verdict(looks: list[Look]) -> dict[str, Any]:
    """The thirds of the run side by side; the first one is start-up and warm-up.

    Descriptors and threads are judged by the least number that was seen: Zenoh's attempts to
    connect come and go, and what leaks is there at every look.
    """
    third = len(looks) // 3
    parts = looks[:third], looks[third : 2 * third], looks[2 * third :]
    memory_mb = [_mean(part) for part in parts]
    descriptors = [_range([each.descriptors for each in part]) for part in parts]
    threads = [_range([each.threads for each in part]) for part in parts]
    flat = (
        memory_mb[2] - memory_mb[1] < MOST_GROWTH_MB
        and descriptors[2][0] <= descriptors[1][0]
        and threads[2][0] <= threads[1][0]
    )
    return {
        "resident_mb": [round(each, 1) for each in memory_mb],
        "descriptors": descriptors,
        "threads": threads,
        "flat": flat,
    }


def _range(numbers: list[int]) -> list[int]:
    return [min(numbers), max(numbers)]


def look(pid: int, begin_s: float) -> Look:
    """Memory, descriptors and threads of a process now."""
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return Look(
        time.monotonic() - begin_s,
        int(fields["VmRSS"].split()[0]) / 1024,
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        int(fields["Threads"]),
    )


def _fly(port: int, vehicles: int, rate_hz: float, seconds: float, look_now: Any) -> None:
    command = [sys.executable, "-m", "fuzzbee", "sim", "--to", f"udpout:127.0.0.1:{port}"]
    command += ["--vehicles", str(vehicles), "--rate", str(rate_hz), "--seconds", str(seconds)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as fleet:  # noqa: S603
        while fleet.poll() is None:
            time.sleep(LOOK_S)
            look_now()


def _mean(looks: list[Look]) -> float:
    return sum(each.resident_mb for each in looks) / max(1, len(looks))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=2_000_000)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    main()
