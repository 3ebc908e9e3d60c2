"""The live service under load: simulated vehicles, service and subscriber as real processes.

python benchmarks/live.py --vehicles N --rate HZ --seconds S [--publish-rate HZ] [--plain]
    [--workers N] [--capacity] [--no-floor] [--json]

The vehicles send over UDP on loopback, ``fuzzbee run`` estimates and publishes on Zenoh, a third
process subscribes. With ``--plain`` a script of pymavlink and ahrs (live_plain.py) has the
service's place. Latencies of an attitude:

- ``sample_to_subscriber``: from the sending of its latest sample's datagram to the subscriber's
  callback. The record tells when the service read that sample; its datagram is the vehicle's last
  one sent before.
- ``new_sample_to_subscriber``: the same, of the first attitude after each sample only, so
  that attitudes repeated from an old sample do not count.
- ``tick_late``: the tick against its schedule, the grid of periods under all ticks; a tick that is
  a whole period late shows in ``tick_interval``, from one tick to the next.

``shed_samples`` are those that an overloaded service left out, and counted; ``lost_samples`` those
that the system threw away, of which the service has counted ``lost_counted``. ``yardstick`` is
pymavlink's parser alone on the same datagrams, which tells machines apart. With ``--workers`` the
service has that many; processor time and memory (``resident_mb``: of each process its own and its
part of what they share) are then those of all its processes, ``process_cores`` those of the
service, the process that workers come from, and the workers. With ``--capacity`` the number of
vehicles is searched that is carried with less than 0.1 % of either.
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
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from live_floor import percentiles, pymavlink_parser, udp_echo

HERE = Path(__file__).parent
WARM_UP_S = 2.0  # vehicles appear and estimators align; records of this time are not timed
SETTLE_S = 0.5
# A number of vehicles is carried if less than this share of the samples is lost or left out.
CARRIED = 0.001
FIRST_VEHICLES, MOST_VEHICLES = 64, 500
FINENESS = 0.1
BeginService = Callable[[int, str, float], subprocess.Popen[str]]
TICKS = os.sysconf("SC_CLK_TCK")


def main() -> None:
    options = _options()
    begin_service: BeginService = partial(start_service, workers=options.workers)
    if options.plain:
        begin_service = start_plain
    if options.capacity:
        result = capacity(options.rate, options.seconds, options.publish_rate, begin_service)
    else:
        shape = (options.vehicles, options.rate, options.seconds, options.publish_rate)
        result = measure(*shape, begin_service)
    result["yardstick"] = pymavlink_parser(result["vehicles"], options.rate)
    if options.floor:
        result["floor"] = floor(options.vehicles, options.rate)
    if options.json:
        print(json.dumps(result))
    else:
        _show(result)


def measure(
    vehicles: int,
    rate_hz: float,
    seconds: float,
    publish_hz: float,
    begin_service: BeginService,
) -> dict[str, Any]:
    """One run of the three processes."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        sent_file, seen_file = Path(folder, "sent.npy"), Path(folder, "seen.npy")
        service = begin_service(port, endpoint, publish_hz)
        subscriber = start("live_subscriber.py", endpoint, str(seen_file))
        await_word(subscriber.stdout, "ready")
        fleet = start(
            "live_fleet.py", str(port), str(vehicles), str(rate_hz), str(seconds), str(sent_file)
        )
        time.sleep(WARM_UP_S)
        processes = [service.pid, *family(service.pid)]
        others = [subscriber.pid, fleet.pid]
        begin_ns, before = time.time_ns(), [cpu_s(pid) for pid in processes + others]
        time.sleep(seconds - WARM_UP_S)
        end_ns, after = time.time_ns(), [cpu_s(pid) for pid in processes + others]
        fleet.wait()
        time.sleep(SETTLE_S)
        memory_mb = resident_mb(service.pid) if len(processes) == 1 else sum(map(pss_mb, processes))
        subscriber.communicate()
        if fleet.returncode:
            raise SystemExit("the vehicles ended early")
        service.send_signal(signal.SIGINT)
        summary = json.loads(service.communicate()[0])
        sent, seen = np.load(sent_file), np.load(seen_file)
    window = (begin_ns, min(end_ns, int(sent[-1, 1])))
    spent = [round(b - a, 2) for a, b in zip(before, after, strict=True)]
    cpu = {
        "service": round(sum(spent[: len(processes)]), 2),
        "subscriber": spent[-2],
        "fleet": spent[-1],
    }
    window_s = (end_ns - begin_ns) / 1e9
    samples = sum(vehicle["samples"] for vehicle in summary["vehicles"].values())
    shed = sum(vehicle.get("shed", 0) for vehicle in summary["vehicles"].values())
    rejected = sum(sum(v["rejected"].values()) for v in summary["vehicles"].values())
    return {
        "vehicles": vehicles,
        "rate_hz": rate_hz,
        "seconds": seconds,
        **figures(sent, seen, window, publish_hz),
        "sent_samples": len(sent),
        "shed_samples": shed,
        "lost_samples": len(sent) - samples - rejected - shed,
        "lost_counted": summary.get("lost", 0),
        "rejected_samples": rejected,
        "overruns": summary["overruns"],
        "dropped": summary["dropped"],
        "cpu_s": cpu,
        "service_cores": round(cpu["service"] / window_s, 3),
        "process_cores": [round(each / window_s, 3) for each in spent[: len(processes)]],
        "resident_mb": memory_mb,
        "load_average": round(os.getloadavg()[0], 2),
    }


def capacity(
    rate_hz: float, seconds: float, publish_hz: float, begin_service: BeginService
) -> dict[str, Any]:
    """The run with the most vehicles that is carried, found by bisection."""
    carried, too_many, best = 0, MOST_VEHICLES + 1, None
    tried: dict[int, float] = {}
    vehicles = FIRST_VEHICLES
    while too_many - carried > max(1, carried * FINENESS):
        result = measure(vehicles, rate_hz, seconds, publish_hz, begin_service)
        lost = result["lost_samples"] + result["shed_samples"]
        tried[vehicles] = round(lost / max(1, result["sent_samples"]), 4)
        print(f"{vehicles} vehicles: {tried[vehicles]:.2%} lost or shed", file=sys.stderr)
        if tried[vehicles] < CARRIED:
            carried, best = vehicles, result
        else:
            too_many = vehicles
        beyond = too_many > MOST_VEHICLES
        vehicles = min(2 * vehicles, MOST_VEHICLES) if beyond else (carried + too_many) // 2
    if best is None:
        raise SystemExit("not even one vehicle is carried")
    return {**best, "tried": tried}


def figures(
    sent: np.ndarray, seen: np.ndarray, window: tuple[int, int], publish_hz: float
) -> dict[str, Any]:
    """Rates, gaps and latencies from what was sent and what the subscriber saw."""
    window_s = (window[1] - window[0]) / 1e9
    timed = seen[(seen[:, 1] >= window[0]) & (seen[:, 1] < window[1])]
    published, gaps, missing = 0, 0, 0
    latency_ms, fresh_ms = [], []
    for vehicle in np.unique(seen[:, 0]):
        steps = np.diff(seen[seen[:, 0] == vehicle, 4])
        gaps += int((steps != 1).sum())
        missing += int((steps - 1).sum())
        rows = timed[timed[:, 0] == vehicle]
        if len(rows) < 2:
            continue
        published += int(rows[-1, 4] - rows[0, 4]) + 1
        sent_ns = sent[sent[:, 0] == vehicle, 1]
        arrival_ns = (rows[:, 2] - rows[:, 3]) * 1000
        last = np.searchsorted(sent_ns, arrival_ns + 999, side="right") - 1
        ms = (rows[:, 1] - sent_ns[last]) / 1e6
        latency_ms.append(ms)
        fresh_ms.append(ms[1:][np.diff(last) > 0])
    return {
        "published_hz": round(published / window_s, 1),
        "delivered_hz": round(len(timed) / window_s, 1),
        "sequence_gaps": gaps,
        "missing_attitudes": missing,
        "sample_to_subscriber": percentiles(_join(latency_ms)),
        "new_sample_to_subscriber": percentiles(_join(fresh_ms)),
        **tick_figures(np.unique(timed[:, 2]), 1e6 / publish_hz),
    }


def tick_figures(ticks_us: np.ndarray, period_us: float) -> dict[str, Any]:
    """How late the ticks are, in their period, and how far apart.

    The schedule is the grid of periods that most ticks lie right behind.
    """
    if len(ticks_us) < 2:
        return {}
    phase_us = ticks_us % period_us
    counts, edges = np.histogram(phase_us, bins=200, range=(0.0, period_us))
    begin_us = edges[counts.argmax()]
    return {
        "tick_late": percentiles(((phase_us - begin_us) % period_us) / 1e3),
        "tick_interval": percentiles(np.diff(ticks_us) / 1e3),
    }


def floor(vehicles: int, rate_hz: float) -> dict[str, Any]:
    """The times of UDP and Zenoh by themselves."""
    return {
        "udp_one_way": udp_echo(),
        "zenoh_alone": zenoh_alone(vehicles, rate_hz),
    }


def zenoh_alone(vehicles: int, rate_hz: float, seconds: float = 4.0) -> dict[str, float]:
    """Records of the same size and number from one process to another, nothing else."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    arguments = ("publish", endpoint, str(vehicles), str(rate_hz), str(seconds))
    with tempfile.TemporaryDirectory() as folder:
        seen_file = Path(folder, "seen.npy")
        publisher = start("live_floor.py", *arguments)
        await_word(publisher.stdout, "ready")
        subscriber = start("live_subscriber.py", endpoint, str(seen_file))
        await_word(subscriber.stdout, "ready")
        time.sleep(SETTLE_S)
        publisher.communicate("go\n")
        time.sleep(SETTLE_S)
        subscriber.communicate()
        seen = np.load(seen_file)
    timed = seen[seen[:, 4] >= rate_hz]  # from the second second on
    return {
        "delivered": round(len(seen) / (int(seconds * rate_hz) * vehicles), 4),
        **percentiles((timed[:, 1] - timed[:, 2] * 1000) / 1e6),
    }


def start(script: str, *arguments: str) -> subprocess.Popen[str]:
    """A process of the benchmark."""
    return subprocess.Popen(  # noqa: S603
        [sys.executable, str(HERE / script), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A loopback port that is free now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def resident_mb(pid: int) -> float:
    """The largest resident memory of a process so far."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return round(int(line.split()[1]) / 1024, 1)
    return 0.0


def children(process: int) -> list[int]:
    """The processes whose parent this is, the oldest first."""
    found = [
        int(child)
        for task in Path(f"/proc/{process}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    return sorted(found)


def family(process: int) -> list[int]:
    """All processes below this one."""
    below = children(process)
    return below + [each for child in below for each in family(child)]


def pss_mb(process: int) -> float:
    """Memory of a process alone, and its part of what it shares with others."""
    for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return round(int(line.split()[1]) / 1024, 1)
    return 0.0


def start_service(
    port: int, endpoint: str, publish_hz: float, *options: str, workers: int = 1
) -> subprocess.Popen[str]:
    """A service on that UDP port, connected to nobody but at ``endpoint``."""
    # the address is both: nobody else's session is looked for
    zenoh_options = ["-l", endpoint, "-e", endpoint]
    command = [sys.executable, "-m", "fuzzbee", "run", f"udpin:127.0.0.1:{port}", "--json"]
    rates = ["--rate", str(publish_hz), "--workers", str(workers)]
    return _start_and_await([*command, *rates, *zenoh_options, *options])


def start_plain(port: int, endpoint: str, publish_hz: float) -> subprocess.Popen[str]:
    """The plain script in the service's place."""
    arguments = (str(port), endpoint, str(publish_hz))
    return _start_and_await([sys.executable, str(HERE / "live_plain.py"), *arguments])


def _start_and_await(command: list[str]) -> subprocess.Popen[str]:
    service = subprocess.Popen(  # noqa: S603
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "500"},
    )
    await_word(service.stderr, "listening")
    return service


def await_word(stream: IO[str] | None, word: str) -> None:
    """Read until a line has ``word`` in it."""
    assert stream is not None
    said = ""
    for line in stream:
        said += line
        if word in line:
            return
    raise SystemExit(f"a process ended early: {said.strip()}")


def _join(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.empty(0)


def _show(result: dict[str, Any], indent: str = "") -> None:
    for key, value in result.items():
        if isinstance(value, dict):
            print(f"{indent}{key}")
            _show(value, indent + "  ")
        else:
            print(f"{indent}{key:28s}{value}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=1)
    parser.add_argument("--rate", type=float, default=50.0, help="samples a second and vehicle")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--publish-rate", type=float, help="attitudes a second [as --rate]")
    parser.add_argument("--plain", action="store_true", help="pymavlink and ahrs instead")
    parser.add_argument("--workers", type=int, default=1, help="of the service")
    parser.add_argument("--capacity", action="store_true", help="search the most vehicles")
    parser.add_argument("--no-floor", dest="floor", action="store_false")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.publish_rate is None:
        options.publish_rate = options.rate
    if options.seconds <= WARM_UP_S:
        parser.error(f"--seconds: more than {WARM_UP_S:g}")
    return options


if __name__ == "__main__":
    main()
