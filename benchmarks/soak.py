"""Do memory, file descriptors or threads of the live service grow over a long time?

    python benchmarks/soak.py [--seconds 240] [--vehicles 50] [--rate 100]

Simulated vehicles over UDP, ``fuzzbee run`` with a recording, the viewer into a file and metrics
that are read each second, and a subscriber. ``MB``, ``descriptors`` and ``threads`` are those of
the thirds of the run without the seconds to skip; start-up and warm-up are in the first. ``curve``
has the MB of its tenths. Exit status 1 if something grew.
"""

import os
import sys
import tempfile
import urllib.request
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import NamedTuple

import numpy as np
from common.report import Row, parser, show
from processes.trial import Process, Shape, counts, free_port, fuzzbee, run

LOOK_S = 1.0
MOST_GROWTH = 0.05  # between the second third and the last: noise of the allocator
PUBLISH_HZ = 10.0


class Look(NamedTuple):
    """The memory, descriptors and threads of a process at one moment."""

    resident_mb: float
    descriptors: int
    threads: int


def soak(shape: Shape, skip_s: float) -> Row:
    """Fly for so long, and look at the service meanwhile."""
    looks: list[Look] = []
    metrics = free_port()

    def meanwhile(service: Process, _others: list[int]) -> None:
        end_s = monotonic() + shape.seconds - LOOK_S
        while monotonic() < end_s:
            sleep(LOOK_S)
            looks.append(look(service.pid, metrics))

    with tempfile.TemporaryDirectory() as name:
        files = ("--record", f"{name}/recorded", "--rrd", f"{name}/seen.rrd")
        everything = (*files, "--metrics", str(metrics))
        seen = run(shape, lambda *where: fuzzbee(*where, *everything), meanwhile)
        recorded_mb = sum(f.stat().st_size for f in Path(name, "recorded").iterdir()) / 1e6
    row = {"vehicles": shape.vehicles, "Hz": shape.rate_hz, **counts(seen)}
    left = looks[round(skip_s / LOOK_S) :]
    return {**row, "recorded MB": round(recorded_mb, 1), **verdict(left)}


def look(pid: int, metrics: int) -> Look:
    """Memory, descriptors and threads of a process now, after its metrics have been read."""
    with suppress(OSError):  # at its beginning nobody answers
        urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=5.0).read()
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    descriptors = len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208 - numbers, no paths
    return Look(int(fields["VmRSS"].split()[0]) / 1024, descriptors, int(fields["Threads"]))


def verdict(looks: list[Look]) -> Row:
    """The thirds of the run side by side.

    Descriptors and threads are judged by the least number that was seen: Zenoh's attempts to
    connect come and go, and what leaks is there at every look.
    """
    third = len(looks) // 3
    parts = looks[:third], looks[third : 2 * third], looks[2 * third :]
    mb = [round(sum(each.resident_mb for each in part) / len(part), 1) for part in parts]
    descriptors = [[each.descriptors for each in part] for part in parts]
    threads = [[each.threads for each in part] for part in parts]
    tenths = np.array_split([each.resident_mb for each in looks], 10)
    grew = mb[2] - mb[1] >= MOST_GROWTH * mb[1] or any(
        min(numbers[2]) > min(numbers[1]) for numbers in (descriptors, threads)
    )
    return {
        "MB": mb,
        "curve": [round(float(np.mean(each)), 1) for each in tenths if len(each)],
        "descriptors": [f"{min(part)}..{max(part)}" for part in descriptors],
        "threads": [f"{min(part)}..{max(part)}" for part in threads],
        "flat": not grew,
    }


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--seconds", type=float, default=240.0)
    made.add_argument("--vehicles", type=int, default=50)
    made.add_argument("--rate", type=float, default=100.0)
    made.add_argument("--skip", type=float, default=0.0, help="seconds that are not judged")
    options = made.parse_args()
    if options.smoke:
        options.seconds, options.vehicles = 4.0, 2
    shape = Shape(options.vehicles, options.rate, options.seconds, PUBLISH_HZ)
    row = soak(shape, options.skip)
    show({"the service over time": [row]}, as_json=options.json)
    return 0 if row["flat"] or options.smoke else 1  # seconds are start-up only


if __name__ == "__main__":
    sys.exit(main())
