"""The live service when there is too much: a burst, a stop, other work; with real processes.

python benchmarks/live_overload.py [--vehicles N] [--rate HZ] [--seconds S] [--workers N] [--json]

``burst``: ten times as many vehicles for a third of the time. ``stopped``: the service stands still
(SIGSTOP) for 9 s, then goes on. ``busy``: two processes that do nothing but compute run beside it.
Of each the time before, during and after, of the vehicles that are there all the time: attitudes a
second, ``age``, from the sending of the sample that an attitude is of to the subscriber's callback,
``age_at_tick`` of it when the attitude was made, and ``tick_interval``. At the end of a trial:
samples that were ``sent``, ``taken``, ``shed``, ``lost`` by the system as the service has counted,
and those that nobody has counted.
"""

import argparse
import itertools
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
from typing import Any

import numpy as np
from live import SETTLE_S, WARM_UP_S, await_word, figures, free_port, start, start_service
from live_floor import percentiles

STOP_S = 9.0
RECOVERY_S = 1.0  # after a trouble, before what comes counts as after it
BURST = 10
BUSY = 2


def main() -> None:
    options = _options()
    shape = (options.vehicles, options.rate, options.seconds, options.workers)
    third_s = (options.seconds - WARM_UP_S) / 3.0
    begin_s, end_s = WARM_UP_S + third_s, WARM_UP_S + 2.0 * third_s
    result = {
        "burst": trial(shape, (begin_s, end_s), factor=BURST),
        "stopped": trial(shape, (begin_s, begin_s + STOP_S), trouble=_stop),
        "busy": trial(shape, (begin_s, end_s), trouble=_compete),
    }
    if options.json:
        print(json.dumps(result))
        return
    for name, parts in result.items():
        print(name)
        for part, numbers in parts.items():
            print(f"  {part:10s}", json.dumps(numbers))


def trial(
    shape: tuple[int, float, float, int],
    span_s: tuple[float, float],
    factor: int = 1,
    trouble: Callable[[int, float], None] = lambda _pid, _s: None,
) -> dict[str, Any]:
    """One run with a trouble in the ``span_s`` of it; ``factor`` times the vehicles meanwhile."""
    vehicles, rate_hz, seconds, workers = shape
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        sent_file, seen_file = Path(folder, "sent.npy"), Path(folder, "seen.npy")
        service = start_service(port, endpoint, rate_hz, workers=workers)
        # nobody reads it else, and a pipe that is full would stop the service
        threading.Thread(target=service.stderr.read, daemon=True).start()  # type: ignore[union-attr]
        subscriber = start("live_subscriber.py", endpoint, str(seen_file))
        await_word(subscriber.stdout, "ready")
        numbers = (factor * vehicles, rate_hz, seconds, sent_file, vehicles, *span_s)
        fleet = start("live_fleet.py", str(port), *map(str, numbers))
        start_ns = time.time_ns()
        time.sleep(span_s[0])
        trouble(service.pid, span_s[1] - span_s[0])
        fleet.wait()
        time.sleep(SETTLE_S)
        subscriber.communicate()
        service.send_signal(signal.SIGINT)
        assert service.stdout is not None
        summary = json.loads(service.stdout.read())
        service.wait()
        sent, seen = np.load(sent_file), np.load(seen_file)
    seen = seen[seen[:, 0] <= vehicles]  # who is there all the time
    marks_s = (WARM_UP_S, *span_s, span_s[1] + RECOVERY_S, seconds)
    marks_ns = [start_ns + int(mark_s * 1e9) for mark_s in marks_s]
    before, during, _, after = (
        _part(sent, seen, (begin, end), rate_hz) for begin, end in itertools.pairwise(marks_ns)
    )
    told = summary["vehicles"].values()
    taken = sum(each["samples"] + sum(each["rejected"].values()) for each in told)
    shed, lost = sum(each["shed"] for each in told), summary["lost"]
    counts = {
        "sent": len(sent),
        "taken": taken,
        "shed": shed,
        "lost": lost,
        "uncounted": len(sent) - taken - shed - lost,
        "dropped": summary["dropped"],
        "load_average": round(os.getloadavg()[0], 2),
    }
    return {"before": before, "during": during, "after": after, "counts": counts}


def _part(
    sent: np.ndarray, seen: np.ndarray, window: tuple[int, int], rate_hz: float
) -> dict[str, Any]:
    found = figures(sent, seen, window, rate_hz)
    during = seen[(seen[:, 2] * 1000 >= window[0]) & (seen[:, 2] * 1000 < window[1])]
    return {
        "sent_hz": round(
            1e9
            * float(((sent[:, 1] >= window[0]) & (sent[:, 1] < window[1])).mean())
            * len(sent)
            / (window[1] - window[0])
        ),
        "delivered_hz": found["delivered_hz"],
        "age": found["sample_to_subscriber"],
        "age_at_tick": percentiles(during[:, 3] / 1e3),
        "tick_interval": found.get("tick_interval", {}),
    }


def _stop(service: int, seconds: float) -> None:
    os.kill(service, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(service, signal.SIGCONT)


def _compete(_service: int, seconds: float) -> None:
    command = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(command) for _ in range(BUSY)]  # noqa: S603
    time.sleep(seconds)
    for process in busy:
        process.kill()
        process.wait()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--rate", type=float, default=50.0, help="samples a second and vehicle")
    parser.add_argument("--seconds", type=float, default=26.0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    main()
