"""The live service against the replay of its own record: the same attitudes?

python benchmarks/live_replay.py LOG [--rate HZ] [--from S] [--seconds S] [--json]

A telemetry log goes over UDP on loopback, at the pace it was recorded at, into ``fuzzbee run
--record``; a Zenoh subscriber keeps the attitudes that are published. The record is then handled
twice. With a tick wherever the service had one, which tells whether live and replay have the same
state: what they differ by is *state*. And as ``fuzzbee replay`` does it, attitudes at the samples:
a published one is propagated up to its tick with the last rate, the replayed one is known at the
samples around it. What they differ by, with the vehicle's turning since, is *ahead*.

Degrees: RMS, the 99th percentile, and the largest.
"""

import argparse
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zenoh
from live import await_word, free_port
from live_subscriber import client
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from drivers.events import Event, Imu
from drivers.logs.open import open_log
from drivers.logs.tlog import TlogRecords
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published

Floats = NDArray[np.float64]
SETTLE_S = 1.0
LATE_S = 0.002  # a datagram this late is sent at once, and counted


class Live(NamedTuple):
    """What the service did."""

    published: list[AttitudeRecord]
    summary: dict[str, Any]
    late: int  # datagrams that this machine sent late


def main() -> None:
    parser = argparse.ArgumentParser(description="The live service against its record's replay.")
    parser.add_argument("log")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ")
    parser.add_argument("--from", dest="begin_s", type=float, default=0.0, metavar="S")
    parser.add_argument("--seconds", type=float, default=1e9, metavar="S")
    parser.add_argument("--skip", type=float, default=20.0, metavar="S", help="of the beginning")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    frames = list(chosen_frames(Path(options.log), options.begin_s, options.seconds))
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder, "record.tlog")
        live = play(frames, record, options.rate)
        with open_log(record) as log:
            events = list(log)
    result = compare(live, events, options.skip)
    if options.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:16s} {value}")


def chosen_frames(path: Path, begin_s: float, seconds: float) -> Iterator[tuple[float, bytes]]:
    """Seconds since the first, and the frame, of a part of a log."""
    first_us = None
    for stamp_us, frame in TlogRecords(path.read_bytes(), None).readable():
        first_us = stamp_us if first_us is None else first_us
        at_s = 1e-6 * (stamp_us - first_us) - begin_s
        if 0.0 <= at_s < seconds:
            yield at_s, bytes(frame.data)


def play(frames: list[tuple[float, bytes]], record: Path, rate_hz: float) -> Live:
    """Send the frames to a service that records them; what it published."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "fuzzbee", "run", f"udpin:127.0.0.1:{port}", "--json"]
    command += ["--rate", str(rate_hz), "--record", str(record), "-l", endpoint, "-e", endpoint]
    service = subprocess.Popen(  # noqa: S603
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    await_word(service.stderr, "listening")
    published: list[AttitudeRecord] = []
    decode = msgspec.json.Decoder(AttitudeRecord).decode

    def keep(sample: zenoh.Sample) -> None:
        published.append(decode(sample.payload.to_bytes()))

    with client(endpoint) as session, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        session.declare_subscriber("fuzzbee/*/attitude", keep)
        time.sleep(SETTLE_S)
        late = send(link, port, frames)
        time.sleep(SETTLE_S)
        service.send_signal(signal.SIGINT)
        summary = json.loads(service.communicate()[0])
    return Live(published, summary, late)


def send(link: socket.socket, port: int, frames: list[tuple[float, bytes]]) -> int:
    """Each frame at its time; how many went later than that."""
    begin_s, late = time.monotonic() - frames[0][0], 0
    for at_s, data in frames:
        ahead_s = begin_s + at_s - time.monotonic()
        late += ahead_s < -LATE_S
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        link.sendto(data, ("127.0.0.1", port))
    return late


def compare(live: Live, events: list[Event], skip_s: float) -> dict[str, Any]:
    """How far what was published is off the replay of what was recorded."""
    published = sorted(live.published, key=lambda each: each.time_unix_us)
    begin_us = published[0].time_unix_us + round(1e6 * skip_s)
    published = [each for each in published if each.time_unix_us >= begin_us]
    again, at_samples = replay_with_ticks(events, [each.time_unix_us for each in published])
    pairs = [(each, again[each.time_unix_us]) for each in published if each.time_unix_us in again]
    mine = np.array([a.q_ned_frd for a, _ in pairs])
    theirs = np.array([b.q_ned_frd for _, b in pairs])
    boot_us = np.array([a.time_boot_us for a, _ in pairs])
    sampled_us = np.array([us for us, _ in at_samples])
    between = np.searchsorted(sampled_us, boot_us)
    inside = (between > 0) & (between < len(sampled_us))
    expected = interpolate(at_samples, boot_us[inside])
    age_ms = np.array([a.age_ms - b.age_ms for a, b in pairs])
    shown_us = np.array([a.time_boot_us - b.time_boot_us for a, b in pairs])
    return {
        "published": len(published),
        "compared": len(pairs),
        "samples": sum(v["samples"] for v in live.summary["vehicles"].values()),
        "samples_replayed": len(at_samples),
        "sent_late": live.late,
        "overruns": live.summary["overruns"],
        "state_deg": figures(mine, theirs),
        "ahead_deg": figures(mine[inside], expected),
        "same_sample": round(float(np.mean(np.abs(age_ms) < 0.01)), 4),
        "time_differs_ms": round(float(np.abs(shown_us).max()) / 1e3, 3),
    }


def replay_with_ticks(
    events: list[Event], ticks_us: list[int]
) -> tuple[dict[int, AttitudeRecord], list[tuple[int, Any]]]:
    """The record through the pipeline with the service's ticks: what it publishes at each.

    And the attitudes at the samples, (time since boot in us, q_ned_frd), as a replay has them.
    """
    pipeline = Pipeline(load_profile("imu"))
    again: dict[int, AttitudeRecord] = {}
    at_samples: list[tuple[int, Any]] = []
    due = iter(ticks_us)
    tick_us = next(due, None)
    for event in events:
        while tick_us is not None and event.arrival_us > tick_us:
            for output in pipeline.tick(tick_us):
                if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                    again[tick_us] = output.record
            tick_us = next(due, None)
        pipeline.handle(event)
        if isinstance(event, Imu):
            vehicle = pipeline.vehicle(event.vehicle)
            if vehicle is not None and vehicle.has_taken(event):
                attitude = vehicle.estimator.attitude(event.sample.time_us)
                at_samples.append((event.boot_us, attitude.q_ned_frd))
    return again, at_samples


def interpolate(at_samples: list[tuple[int, Any]], times_us: NDArray[np.int64]) -> Floats:
    """``q_ned_frd`` (N, 4) at times between samples, by the straight line on the sphere."""
    sampled_us = np.array([us for us, _ in at_samples], dtype=float)
    q = np.array([each for _, each in at_samples])
    after = np.clip(np.searchsorted(sampled_us, times_us), 1, len(q) - 1)
    before = after - 1
    share = (times_us - sampled_us[before]) / (sampled_us[after] - sampled_us[before])
    second = q[after] * np.sign(np.sum(q[before] * q[after], axis=1))[:, None]
    mixed = q[before] + share[:, None] * (second - q[before])
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1)[:, None])


def figures(some: Floats, others: Floats) -> dict[str, float]:
    """Angles between attitudes, degrees."""
    angles = np.degrees(batch_angle_errors(some, others)[:, 0])
    return {
        "rms": round(float(np.sqrt(np.mean(angles**2))), 4),
        "p99": round(float(np.percentile(angles, 99.0)), 4),
        "max": round(float(angles.max()), 4),
    }


if __name__ == "__main__":
    main()
