"""Do memory, file descriptors or threads of the live service grow over a long time?

    python benchmarks/soak.py [--seconds 240] [--vehicles 50] [--rate 100]
    python benchmarks/soak.py --hours 8 [--speed 2000]

Simulated vehicles over UDP, ``fuzzbee run`` with signatures, a recording, the viewer into a file
and metrics that are read each second, and a subscriber. The vehicles are started anew a few times
(reboots, new UDP ports, silence), and beside them others come and go with new ids all the time.
With ``--hours``, a log of so many hours in which vehicles come and go is played at that speed.
``MB``, ``descriptors`` and ``threads`` are those of the thirds of the run, the first of which is
start-up and warm-up. Exit status 1 if something grew.
"""

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from common.report import Row, parser, show
from processes.comers import Plan, write_day
from processes.trial import await_word, end, free_port, fuzzbee, start

ROUND_S, PAUSE_S = 45.0, 1.5
LOOK_S = 1.0
MOST_GROWTH_MB = 5.0  # between the second third and the last: noise of the allocator
PUBLISH_HZ = 10.0
KEY = "a pass phrase for the soak"
DAY = Plan(at_a_time=3, stay_s=30.0, rate_hz=5.0)


class Look(NamedTuple):
    """The memory, descriptors and threads of a process at one moment."""

    resident_mb: float
    descriptors: int
    threads: int


def soak(seconds: float, vehicles: int, rate_hz: float) -> Row:
    """Fly for so long, and look at the service meanwhile."""
    port, endpoint, metrics = (
        free_port(socket.SOCK_DGRAM),
        f"tcp/127.0.0.1:{free_port()}",
        free_port(),
    )
    looks: list[Look] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        key = folder / "key"
        key.write_text(KEY)
        os.environ["XDG_STATE_HOME"] = name  # the signatures' stamps
        everything = ("--signing-key-file", str(key), "--record", str(folder / "recorded"))
        service = fuzzbee(port, endpoint, PUBLISH_HZ, *everything, *watched(folder, metrics))
        subscriber = start("subscriber.py", endpoint, str(folder / "seen.npy"))
        await_word(subscriber.stdout, "ready")
        comers = start("comers.py", str(port), str(seconds), str(key))
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0:
            with fleet(port, vehicles, rate_hz, min(ROUND_S, left_s), key) as flying:
                while flying.poll() is None:
                    time.sleep(LOOK_S)
                    looks.append(look(service.pid, metrics))
            time.sleep(PAUSE_S)
        comers.communicate()
        subscriber.communicate()
        summary = end(service)
        recorded_mb = sum(f.stat().st_size for f in (folder / "recorded").iterdir()) / 1e6
    return {"recorded MB": round(recorded_mb, 1), **told(summary), **verdict(looks)}


def fleet(
    port: int, vehicles: int, rate_hz: float, seconds: float, key: Path
) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "fuzzbee", "sim", "--to", f"udpout:127.0.0.1:{port}"]
    command += ["--vehicles", str(vehicles), "--rate", str(rate_hz), "--seconds", str(seconds)]
    command += ["--signing-key-file", str(key)]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)  # noqa: S603


def day(hours: float, speed: float) -> Row:
    """Play a log of so many hours."""
    looks: list[Look] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log, metrics, endpoint = folder / "day.tlog", free_port(), f"tcp/127.0.0.1:{free_port()}"
        samples = write_day(log, hours, DAY)
        command = [sys.executable, "-m", "fuzzbee", "run", str(log), "--speed", str(speed)]
        command += ["--json", "-l", endpoint, "-e", endpoint, *watched(folder, metrics)]
        # into a file: a pipe is full before the summary of so many vehicles is written
        with (
            (folder / "summary.json").open("w+") as out,
            subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL) as service,  # noqa: S603
        ):
            time.sleep(LOOK_S)
            while service.poll() is None:
                looks.append(look(service.pid, metrics))
                time.sleep(LOOK_S)
            out.seek(0)
            summary = json.loads(out.read())
    return {"samples in the log": samples, **told(summary), **verdict(looks)}


def watched(folder: Path, metrics: int) -> tuple[str, ...]:
    return ("--metrics", str(metrics), "--rrd", str(folder / "seen.rrd"))


def told(summary: dict[str, Any]) -> Row:
    """What the service says of itself."""
    vehicles, departed = summary["vehicles"].values(), summary["departed"]
    rejected = sum((Counter(vehicle["rejected"]) for vehicle in vehicles), Counter[str]())
    return {
        "samples": departed["samples"] + sum(vehicle["samples"] for vehicle in vehicles),
        "vehicles at the end": len(vehicles),
        "departed": departed["vehicles"],
        **{name: summary[name] for name in ("seconds", "ticks", "overruns", "dropped", "refused")},
        "rejected": dict(rejected),
    }


def verdict(looks: list[Look]) -> Row:
    """The thirds of the run side by side.

    Descriptors and threads are judged by the least number that was seen: Zenoh's attempts to
    connect come and go, and what leaks is there at every look.
    """
    third = max(1, len(looks) // 3)
    parts = [part for part in (looks[:third], looks[third : 2 * third], looks[2 * third :]) if part]
    mb = [round(sum(each.resident_mb for each in part) / len(part), 1) for part in parts]
    least = [(min(e.descriptors for e in part), min(e.threads for e in part)) for part in parts]
    most = [(max(e.descriptors for e in part), max(e.threads for e in part)) for part in parts]
    grew = mb[-1] - mb[-2:][0] >= MOST_GROWTH_MB or any(
        last > before for last, before in zip(least[-1], least[-2:][0], strict=True)
    )
    ranges = [
        [f"{a}..{b}" for a, b in zip(*ends, strict=True)] for ends in zip(least, most, strict=True)
    ]
    descriptors, threads = (list(column) for column in zip(*ranges, strict=True))
    return {"MB": mb, "descriptors": descriptors, "threads": threads, "flat": not grew}


def look(pid: int, metrics: int) -> Look:
    """Memory, descriptors and threads of a process now, after its metrics have been read."""
    with suppress(OSError):  # at its beginning and end nobody answers
        urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=5.0).read()
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return Look(
        int(fields.get("VmRSS", "0").split()[0]) / 1024,
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        int(fields["Threads"]),
    )


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--seconds", type=float, default=240.0)
    made.add_argument("--vehicles", type=int, default=50)
    made.add_argument("--rate", type=float, default=100.0)
    made.add_argument("--hours", type=float)
    made.add_argument("--speed", type=float, default=2000.0)
    options = made.parse_args()
    if options.smoke:
        options.seconds, options.vehicles, options.hours = 5.0, 2, None
    if options.hours is None:
        row = soak(options.seconds, options.vehicles, options.rate)
    else:
        row = day(options.hours, options.speed)
    show({"the service over time": [row]}, as_json=options.json)
    return 0 if row["flat"] or options.smoke else 1  # seconds are start-up only


if __name__ == "__main__":
    sys.exit(main())
