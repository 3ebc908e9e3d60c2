"""How many vehicles does the live service carry, how late, at what cost, and with what troubles?

    python benchmarks/live.py --vehicles 200 --rate 50 --seconds 20 [--plain] [--record FOLDER]
    python benchmarks/live.py --capacity | --troubles burst,stopped,busy | --soak

The vehicles send over UDP on loopback, ``fuzzbee run`` estimates and publishes on Zenoh, a third
process subscribes. With ``--plain`` a script of pymavlink and ahrs (processes/plain.py) has the
service's place. Times are median, 99th percentile and worst in ms, of an attitude:

- ``sample to subscriber``: from the sending of its latest sample's datagram to the subscriber's
  callback; ``new sample to subscriber`` of the first attitude after each sample only.
- ``tick late``: the tick against its schedule, the grid of periods under all ticks; a tick that is
  a whole period late shows in ``ticks apart``.

``shed`` samples are those that an overloaded service left out, ``lost`` those that the system
dropped, as the service has counted; ``uncounted`` the others that were not taken. Cores and memory
are those of all processes of the service. ``--capacity`` searches the number of vehicles that is
carried with less than 0.1 % not taken.

``--troubles``: ten times as many vehicles for a third of the time (``burst``), a service that is
stopped (SIGSTOP) for 9 s, or two processes that compute beside it (``busy``). Rows are the time
before, during and after, of the vehicles that are there all the time, then what became of all
samples; ``longest gap s`` is the longest time without an attitude, median and worst of the
vehicles with one over 0.2 s.

``--soak``: four minutes of 50 vehicles at 100 Hz with a recording, the viewer into a file and
metrics. ``MB``, ``descriptors`` and ``threads`` are those of the thirds of the run; ``flat`` is
whether none of them grew from the second to the last.
"""

import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
from common.filters import is_installed
from common.report import MISSING, Row, Tables, benchmark, names, option
from processes import trial
from processes.trial import BeginService, Process, Seen, Shape

from tests.fuzzbee.processes import cpu_s, descendants, free_port

# A number of vehicles is carried if less than this share of the samples is lost or left out.
CARRIED = 0.001
FIRST_VEHICLES, MOST_VEHICLES, FINENESS = 64, 500, 0.1
STOP_S, RECOVERY_S, GAP_S = 9.0, 1.0, 0.2
BURST, BUSY = 10, 2  # times the vehicles, and processes
MOST_GROWTH = 0.05  # between the second third and the last: noise of the allocator


def measure(shape: Shape, begin_service: BeginService) -> Row:
    """One run of the processes."""
    marks: list[tuple[int, list[float]]] = []
    memory: list[float] = []

    def meanwhile(service: Process, others: list[int]) -> None:
        time.sleep(trial.WARM_UP_S)
        processes = [service.pid, *descendants(service.pid), *others]
        for wait_s in (0.0, shape.seconds - trial.WARM_UP_S - 0.2):
            time.sleep(wait_s)
            marks.append((time.time_ns(), [cpu_s(pid) for pid in processes]))
        alone = map(psutil.Process, processes[: -len(others)])
        # PSS: its own, and its part of what it shares with others
        memory.extend(round(each.memory_full_info().pss / 2**20, 1) for each in alone)

    seen = trial.run(shape, begin_service, meanwhile)
    (begin_ns, before), (end_ns, after) = marks
    window_s = (end_ns - begin_ns) / 1e9
    cores = [round((b - a) / window_s, 3) for a, b in zip(before, after, strict=True)]
    return {
        "vehicles": shape.vehicles,
        "Hz": shape.rate_hz,
        **trial.figures(seen, (begin_ns, end_ns), shape.publish_hz),
        **trial.counts(seen),
        "cores of the service": cores[: len(memory)],
        "of subscriber, fleet": cores[len(memory) :],
        "MB": round(sum(memory), 1),
    }


def capacity(shape: Shape, begin_service: BeginService) -> Row:
    """The run with the most vehicles that is carried, found by bisection."""
    carried, too_many, best = 0, MOST_VEHICLES + 1, None
    vehicles = FIRST_VEHICLES
    while too_many - carried > max(1, carried * FINENESS):
        result = measure(shape._replace(vehicles=vehicles), begin_service)
        lost = 1.0 - result["taken"] / max(1, result["sent"])
        print(f"{vehicles} vehicles: {lost:.2%} not taken", file=sys.stderr)
        if lost < CARRIED:
            carried, best = vehicles, result
        else:
            too_many = vehicles
        beyond = too_many > MOST_VEHICLES
        vehicles = min(2 * vehicles, MOST_VEHICLES) if beyond else (carried + too_many) // 2
    if best is None:
        raise SystemExit("not even one vehicle is carried")
    return best


def load(shape: Shape, options: Namespace) -> Iterator[Row]:
    """A row a service."""
    recorder = ("--record", options.record) if options.record else ()
    services: dict[str, BeginService | None] = {
        "fuzzbee": lambda *where: trial.fuzzbee(*where, *recorder),
        "plain script": trial.plain if is_installed("mahony") else None,
    }
    chosen = list(services) if options.smoke else ["plain script" if options.plain else "fuzzbee"]
    found = capacity if options.capacity else measure
    for name in chosen:
        begin = services[name]
        row = found(shape, begin) if begin else {"vehicles": f"ahrs: {MISSING}"}
        yield {"service": name, **row}


def stop(service: int, seconds: float) -> None:
    os.kill(service, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(service, signal.SIGCONT)


def compete(_service: int, seconds: float) -> None:
    command = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(command) for _ in range(BUSY)]  # noqa: S603
    time.sleep(seconds)
    for process in busy:
        process.kill()
        process.wait()


# By name: what is done to the service's process for how long (s); the vehicles of that time come on
# top, as many times as the others.
TROUBLES: dict[str, tuple[Callable[[int, float], None], int]] = {
    "burst": (lambda _, seconds: time.sleep(seconds), BURST),
    "stopped": (stop, 1),
    "busy": (compete, 1),
}


def troubled(name: str, shape: Shape) -> list[Row]:
    """One run with the trouble in the middle third of it."""
    trouble, times = TROUBLES[name]
    third_s = (shape.seconds - trial.WARM_UP_S) / 3.0
    begin_s, lasts_s = trial.WARM_UP_S + third_s, STOP_S if name == "stopped" else third_s
    few, span_s = shape.vehicles, (begin_s, begin_s + lasts_s)
    shape = shape._replace(vehicles=few * times, few=few, burst_s=span_s)

    def meanwhile(service: Process, _others: list[int]) -> None:
        time.sleep(begin_s)
        trouble(service.pid, lasts_s)

    seen = trial.run(shape, trial.fuzzbee, meanwhile)
    always = seen._replace(attitudes=seen.attitudes[seen.attitudes[:, 0] <= few])
    marks_s = (trial.WARM_UP_S, *span_s, span_s[1] + RECOVERY_S, shape.seconds)
    marks_ns = [seen.start_ns + int(mark_s * 1e9) for mark_s in marks_s]
    parts = zip(("before", "during", "", "after"), itertools.pairwise(marks_ns), strict=True)
    rows: list[Row] = [
        {"trouble": name, "when": when, **trial.figures(always, window_ns, shape.publish_hz)}
        for when, window_ns in parts
        if when
    ]
    gaps = {"longest gap s": longest_gaps(always, marks_ns[0])}
    return [*rows, {"trouble": name, "when": "in all", **trial.counts(seen), **gaps}]


def longest_gaps(seen: Seen, begin_ns: int) -> list[float] | None:
    """Of the vehicles that were without an attitude for long: median and worst, s."""
    rows = seen.attitudes[seen.attitudes[:, 1] >= begin_ns]
    gaps = [
        1e-9 * float(np.diff(rows[rows[:, 0] == vehicle, 1]).max(initial=0))
        for vehicle in np.unique(rows[:, 0])
    ]
    found = [gap for gap in gaps if gap > GAP_S]
    return [round(float(np.median(found)), 3), round(max(found), 3)] if found else None


def soak(shape: Shape) -> Row:
    """Look at the service each second of a long run."""
    looks: list[tuple[float, int, int]] = []
    metrics = free_port()

    def meanwhile(service: Process, _others: list[int]) -> None:
        end_s = time.monotonic() + shape.seconds - 1.0
        while time.monotonic() < end_s:
            time.sleep(1.0)
            looks.append(look(service.pid, metrics))

    with tempfile.TemporaryDirectory() as name:
        files = ("--record", f"{name}/recorded", "--rrd", f"{name}/seen.rrd")
        everything = (*files, "--metrics", str(metrics))
        seen = trial.run(shape, lambda *where: trial.fuzzbee(*where, *everything), meanwhile)
        recorded_mb = sum(f.stat().st_size for f in Path(name, "recorded").iterdir()) / 1e6
    row = {"vehicles": shape.vehicles, "Hz": shape.rate_hz, **trial.counts(seen)}
    return {**row, "recorded MB": round(recorded_mb, 1), **verdict(looks)}


def look(pid: int, metrics: int) -> tuple[float, int, int]:
    """Memory (MB), descriptors and threads of a process, after its metrics have been read."""
    with suppress(OSError):  # at its beginning nobody answers
        urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=5.0).read()
    process = psutil.Process(pid)
    return process.memory_info().rss / 2**20, process.num_fds(), process.num_threads()


def verdict(looks: list[tuple[float, int, int]]) -> Row:
    """The thirds of the run side by side.

    Descriptors and threads are judged by the least number that was seen: Zenoh's attempts to
    connect come and go, and what leaks is there at every look.
    """
    mb, descriptors, threads = (np.array_split(column, 3) for column in zip(*looks, strict=True))
    means = [round(float(np.mean(part)), 1) for part in mb]
    grew = means[2] - means[1] >= MOST_GROWTH * means[1] or any(
        part[2].min() > part[1].min() for part in (descriptors, threads)
    )
    row: Row = {"MB": means}
    for name, parts in (("descriptors", descriptors), ("threads", threads)):
        row[name] = [f"{part.min()}..{part.max()}" for part in parts]
    return {**row, "flat": not grew}


@benchmark(
    option("--vehicles", type=int),
    option("--rate", type=float, help="samples a second and vehicle"),
    option("--seconds", type=float),
    option("--publish-rate", type=float, help="attitudes a second [as --rate]"),
    option("--record", default="", help="folder that the service records to"),
    option("--plain", action="store_true", help="pymavlink and ahrs instead"),
    option("--capacity", action="store_true", help="search the most vehicles"),
    option(
        "--troubles", nargs="?", const=",".join(TROUBLES), help="names with commas between them"
    ),
    option("--soak", action="store_true", help="does anything grow over a long time?"),
)
def main(options: Namespace) -> Tables:
    """The chosen one, or all in a smoke test."""
    sizes = {"load": (1, 50.0, 10.0), "troubles": (30, 50.0, 26.0), "soak": (50, 100.0, 240.0)}
    if options.smoke:
        sizes = {"load": (2, 50.0, 4.0), "troubles": (2, 50.0, 6.5), "soak": (2, 50.0, 4.0)}
        options.capacity, options.troubles = False, "burst"

    def shape(kind: str, publish_hz: float | None = None) -> Shape:
        given = (options.vehicles, options.rate, options.seconds)
        vehicles, rate, seconds = (
            usual if own is None else own for own, usual in zip(given, sizes[kind], strict=True)
        )
        return Shape(vehicles, rate, seconds, publish_hz or rate)

    found: dict[str, list[Row]] = {}
    if options.troubles:
        runs = [troubled(name, shape("troubles")) for name in names(TROUBLES, options.troubles)]
        found["troubles"] = list(itertools.chain(*runs))
    if options.soak or options.smoke:
        found["soak"] = [soak(shape("soak", 10.0))]
    if options.smoke or not found:
        found["load"] = [*load(shape("load", options.publish_rate), options)]
    return found
