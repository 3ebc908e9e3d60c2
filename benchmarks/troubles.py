"""What happens to the live service when there is too much?

    python benchmarks/troubles.py [--vehicles 30] [--rate 50] [--only burst,stopped]

``burst``: ten times as many vehicles for a third of the time. ``stopped``: the service stands still
(SIGSTOP) for 9 s, then goes on. ``busy``: two processes that do nothing but compute run beside it.
Rows are the time before, during and after, of the vehicles that are there all the time; times are
median, 99th percentile and worst in ms, as in live.py. ``longest gap s`` is the longest time that a
vehicle was without an attitude, of those that had one of more than 0.2 s: median and worst.
``in all`` has what became of the samples.
"""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
from common.report import Row, names, parser, show
from processes.trial import (
    WARM_UP_S,
    Process,
    Seen,
    Shape,
    counts,
    figures,
    fuzzbee,
    run,
)

STOP_S = 9.0
RECOVERY_S = 1.0  # after a trouble, before what comes counts as after it
GAP_S = 0.2
BURST, BUSY = 10, 2
Trouble = Callable[[int, float], None]  # told the service's process and for how long, s


def nothing(_service: int, seconds: float) -> None:
    time.sleep(seconds)


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


TROUBLES: dict[str, Trouble] = {
    "burst": nothing,
    "stopped": stop,
    "busy": compete,
}


def trial(name: str, shape: Shape, span_s: tuple[float, float]) -> list[Row]:
    """One run with the trouble in the span of it."""

    def meanwhile(service: Process, _others: list[int]) -> None:
        time.sleep(span_s[0])
        TROUBLES[name](service.pid, span_s[1] - span_s[0])

    seen = run(shape, fuzzbee, meanwhile)
    always = seen._replace(attitudes=seen.attitudes[seen.attitudes[:, 0] <= shape.few])
    marks_s = (WARM_UP_S, *span_s, span_s[1] + RECOVERY_S, shape.seconds)
    marks_ns = [seen.start_ns + int(mark_s * 1e9) for mark_s in marks_s]
    parts = zip(("before", "during", "", "after"), itertools.pairwise(marks_ns), strict=True)
    rows: list[Row] = [
        {"trouble": name, "when": when, **figures(always, window_ns, shape.publish_hz)}
        for when, window_ns in parts
        if when
    ]
    gaps = {"longest gap s": longest_gaps(always, marks_ns[0])}
    return [*rows, {"trouble": name, "when": "in all", **counts(seen), **gaps}]


def longest_gaps(seen: Seen, begin_ns: int) -> list[float] | None:
    """Of the vehicles that were without an attitude for long: median and worst, s."""
    rows = seen.attitudes[seen.attitudes[:, 1] >= begin_ns]
    gaps = [
        1e-9 * float(np.diff(rows[rows[:, 0] == vehicle, 1]).max(initial=0))
        for vehicle in np.unique(rows[:, 0])
    ]
    found = [gap for gap in gaps if gap > GAP_S]
    return [round(float(np.median(found)), 3), round(max(found), 3)] if found else None


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--vehicles", type=int, default=30)
    made.add_argument("--rate", type=float, default=50.0, help="samples a second and vehicle")
    made.add_argument("--seconds", type=float, default=26.0)
    made.add_argument("--only", default=",".join(TROUBLES), help="names with commas between them")
    options = made.parse_args()
    chosen = names(TROUBLES, options.only)
    if options.smoke:
        options.vehicles, options.seconds = 2, WARM_UP_S + 4.5
        chosen = ["burst"]
    third_s = (options.seconds - WARM_UP_S) / 3.0
    rows: list[Row] = []
    for name in chosen:
        span_s = (
            WARM_UP_S + third_s,
            WARM_UP_S + (third_s + STOP_S if name == "stopped" else 2.0 * third_s),
        )
        vehicles = options.vehicles * (BURST if name == "burst" else 1)
        shape = Shape(
            vehicles, options.rate, options.seconds, options.rate, options.vehicles, span_s
        )
        rows += trial(name, shape, span_s)
    show({"troubles of the live service": rows}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
