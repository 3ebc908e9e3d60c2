"""The live service over a long time: memory, file descriptors and threads must not grow.

python benchmarks/soak.py [--seconds 240] [--vehicles 50] [--rate 100] [--json]
python benchmarks/soak.py --hours 8 [--speed 2000]

Simulated vehicles over UDP, ``fuzzbee run`` with signatures, a recording, the viewer into a file
and metrics that are read each second, and a subscriber. The vehicles are started anew a few times
(reboots, new UDP ports, silence), and beside them others come and go with new ids all the time.
With ``--hours``, a log of so many hours in which vehicles come and go is played at that speed.
Exit status 1 if something grew.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from live import await_word, free_port, start, start_service
from soak_comers import Plan, write_day

ROUND_S = 45.0
PAUSE_S = 1.5
LOOK_S = 1.0
MOST_GROWTH_MB = 5.0  # between the second third and the last: noise of the allocator
PUBLISH_HZ = 10.0
KEY = "a pass phrase for the soak"
DAY = Plan(at_a_time=3, stay_s=30.0, rate_hz=5.0)


class Look(NamedTuple):
    """The memory, descriptors and threads of a process at one moment."""

    at_s: float
    resident_mb: float
    descriptors: int
    threads: int


def main() -> None:
    options = _options()
    if options.hours is None:
        result = soak(options.seconds, options.vehicles, options.rate)
    else:
        result = day(options.hours, options.speed)
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))
    sys.exit(0 if result["flat"] else 1)


def soak(seconds: float, vehicles: int, rate_hz: float) -> dict[str, Any]:
    """Fly for so long, and look at the service meanwhile."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    looks: list[Look] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        key = folder / "key"
        key.write_text(KEY)
        os.environ["XDG_STATE_HOME"] = name  # the signatures' stamps
        metrics = free_port()
        everything = ("--signing-key-file", str(key), "--record", str(folder / "recorded"))
        service = start_service(port, endpoint, PUBLISH_HZ, *everything, *_watched(folder, metrics))
        subscriber = start("live_subscriber.py", endpoint, str(folder / "seen.npy"))
        await_word(subscriber.stdout, "ready")
        comers = start("soak_comers.py", str(port), str(seconds), str(key))
        begin_s = time.monotonic()

        def look_now() -> None:
            looks.append(look(service.pid, begin_s, metrics))

        while (left_s := seconds - (time.monotonic() - begin_s)) > 0.0:
            _fly(port, vehicles, rate_hz, min(ROUND_S, left_s), key, look_now)
            time.sleep(PAUSE_S)
        comers.communicate()
        subscriber.communicate()
        service.send_signal(signal.SIGINT)
        summary = json.loads(service.communicate()[0])
        recorded_mb = sum(f.stat().st_size for f in (folder / "recorded").iterdir()) / 1e6
    return {
        "vehicles": vehicles,
        "rate_hz": rate_hz,
        "recorded_mb": round(recorded_mb, 1),
        **_told(summary),
        **verdict(looks),
    }


def day(hours: float, speed: float) -> dict[str, Any]:
    """Play a log of so many hours."""
    looks: list[Look] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log, metrics, endpoint = folder / "day.tlog", free_port(), f"tcp/127.0.0.1:{free_port()}"
        samples = write_day(log, hours, DAY)
        command = [sys.executable, "-m", "fuzzbee", "run", str(log), "--speed", str(speed)]
        command += ["--json", "-l", endpoint, "-e", endpoint, *_watched(folder, metrics)]
        # into a file: a pipe is full before the summary of so many vehicles is written
        with (
            (folder / "summary.json").open("w+") as out,
            subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL) as service,  # noqa: S603
        ):
            begin_s = time.monotonic()
            time.sleep(LOOK_S)
            while service.poll() is None:
                looks.append(look(service.pid, begin_s, metrics))
                time.sleep(LOOK_S)
            out.seek(0)
            summary = json.loads(out.read())
    return {"hours": hours, "samples_in_log": samples, **_told(summary), **verdict(looks)}


def _watched(folder: Path, metrics: int) -> tuple[str, ...]:
    return ("--metrics", str(metrics), "--rrd", str(folder / "seen.rrd"))


def _told(summary: dict[str, Any]) -> dict[str, Any]:
    """What the service says of itself."""
    vehicles, departed = summary["vehicles"].values(), summary["departed"]
    rejected: dict[str, int] = {}
    for vehicle in vehicles:
        for reason, number in vehicle["rejected"].items():
            rejected[reason] = rejected.get(reason, 0) + number
    return {
        "samples": departed["samples"] + sum(vehicle["samples"] for vehicle in vehicles),
        "vehicles_at_the_end": len(vehicles),
        "departed": departed["vehicles"],
        "seconds": summary["seconds"],
        "ticks": summary["ticks"],
        "overruns": summary["overruns"],
        "dropped": summary["dropped"],
        "rejected": rejected,
        "refused": summary["refused"],
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


def look(pid: int, begin_s: float, metrics: int) -> Look:
    """Memory, descriptors and threads of a process now, after its metrics have been read."""
    with suppress(OSError):  # at its beginning and end nobody answers
        urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=5.0).read()
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return Look(
        time.monotonic() - begin_s,
        int(fields.get("VmRSS", "0").split()[0]) / 1024,
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        int(fields["Threads"]),
    )


def _fly(
    port: int,
    vehicles: int,
    rate_hz: float,
    seconds: float,
    key: Path,
    look_now: Callable[[], None],
) -> None:
    command = [sys.executable, "-m", "fuzzbee", "sim", "--to", f"udpout:127.0.0.1:{port}"]
    command += ["--vehicles", str(vehicles), "--rate", str(rate_hz), "--seconds", str(seconds)]
    command += ["--signing-key-file", str(key)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as fleet:  # noqa: S603
        while fleet.poll() is None:
            time.sleep(LOOK_S)
            look_now()


def _mean(looks: list[Look]) -> float:
    return sum(each.resident_mb for each in looks) / max(1, len(looks))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--hours", type=float, default=None)
    parser.add_argument("--speed", type=float, default=2000.0)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    main()
