"""Are the attitudes that the live service publishes those of its record's replay?

    python benchmarks/live_replay.py LOG [--rate HZ] [--from S] [--seconds S]

A telemetry log goes over UDP on loopback, at the pace it was recorded at, into ``fuzzbee run
--record``; a Zenoh subscriber keeps the attitudes that are published. The record is then handled
with a tick wherever the service had one, which tells whether live and replay have the same state:
what they differ by is ``state``. ``ahead`` is the difference to the replay's attitudes at the
samples: a published one is propagated up to its tick with the last rate, the replayed one is known
at the samples around it, and the vehicle's turning since is in it. Degrees: RMS, 99th percentile,
largest; from 20 s after the beginning on.
"""

import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zenoh
from common.recordings import Array
from common.report import Row, parser, show
from common.scores import errors_deg, rms
from processes.subscriber import client
from processes.trial import end, free_port, fuzzbee

from drivers.events import Imu
from drivers.logs.open import open_log
from drivers.logs.tlog import TlogRecords
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published

SETTLE_S = 1.0
LATE_S = 0.002  # a datagram this late is sent at once, and counted
SHORT_LOG = Path(__file__).parents[1] / "tests" / "data" / "sitl_copter_flips.tlog"
Frames = list[tuple[float, bytes]]


class Replayed(NamedTuple):
    """The record's replay: what is published at each tick (us), and attitudes at the samples."""

    at_ticks: dict[int, AttitudeRecord]
    sampled_us: list[int]  # since boot
    q_ned_frd: list[Any]


def chosen_frames(path: Path, begin_s: float, seconds: float) -> Iterator[tuple[float, bytes]]:
    """Seconds since the first, and the frame, of a part of a log."""
    first_us = None
    for stamp_us, frame in TlogRecords(path.read_bytes(), None).readable():
        first_us = stamp_us if first_us is None else first_us
        at_s = 1e-6 * (stamp_us - first_us) - begin_s
        if 0.0 <= at_s < seconds:
            yield at_s, bytes(frame.data)


def play(frames: Frames, record: Path, rate_hz: float) -> tuple[list[AttitudeRecord], Row]:
    """Send the frames to a service that records them; what it published, and counts."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    service = fuzzbee(port, endpoint, rate_hz, "--record", str(record))
    published: list[AttitudeRecord] = []
    decode = msgspec.json.Decoder(AttitudeRecord).decode

    def keep(sample: zenoh.Sample) -> None:
        published.append(decode(sample.payload.to_bytes()))

    with client(endpoint) as session, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        session.declare_subscriber("fuzzbee/*/attitude", keep)
        time.sleep(SETTLE_S)
        late = send(link, port, frames)
        time.sleep(SETTLE_S)
        summary = end(service)
    samples = sum(vehicle["samples"] for vehicle in summary["vehicles"].values())
    return published, {"samples": samples, "sent late": late, "overruns": summary["overruns"]}


def send(link: socket.socket, port: int, frames: Frames) -> int:
    """Each frame at its time; how many went later than that."""
    begin_s, late = time.monotonic() - frames[0][0], 0
    for at_s, data in frames:
        ahead_s = begin_s + at_s - time.monotonic()
        late += ahead_s < -LATE_S
        time.sleep(max(0.0, ahead_s))
        link.sendto(data, ("127.0.0.1", port))
    return late


def replay_with_ticks(record: Path, ticks_us: list[int]) -> Replayed:
    """The record through the pipeline with the service's ticks."""
    pipeline, found = Pipeline(load_profile("imu")), Replayed({}, [], [])
    due = iter(ticks_us)
    tick_us = next(due, None)
    with open_log(record) as log:
        for event in log:
            while tick_us is not None and event.arrival_us > tick_us:
                for output in pipeline.tick(tick_us):
                    if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                        found.at_ticks[tick_us] = output.record
                tick_us = next(due, None)
            pipeline.handle(event)
            vehicle = pipeline.vehicle(event.vehicle) if isinstance(event, Imu) else None
            if isinstance(event, Imu) and vehicle is not None and vehicle.has_taken(event):
                attitude = vehicle.estimator.attitude(event.sample.time_us)
                found.sampled_us.append(event.boot_us)
                found.q_ned_frd.append(attitude.q_ned_frd)
    return found


def interpolated(replayed: Replayed, times_us: Array) -> Array:
    """Attitudes (N, 4) at times between samples, by the straight line on the sphere."""
    sampled_us, q = np.array(replayed.sampled_us, dtype=float), np.array(replayed.q_ned_frd)
    after = np.clip(np.searchsorted(sampled_us, times_us), 1, len(q) - 1)
    before = after - 1
    share = (times_us - sampled_us[before]) / (sampled_us[after] - sampled_us[before])
    second = q[after] * np.sign(np.sum(q[before] * q[after], axis=1))[:, None]
    mixed = q[before] + share[:, None] * (second - q[before])
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1)[:, None])


def compared(published: list[AttitudeRecord], record: Path, skip_s: float) -> Row:
    """How far what was published is off the replay of what was recorded."""
    published = sorted(published, key=lambda each: each.time_unix_us)
    begin_us = published[0].time_unix_us + round(1e6 * skip_s)
    published = [each for each in published if each.time_unix_us >= begin_us]
    replayed = replay_with_ticks(record, [each.time_unix_us for each in published])
    again = replayed.at_ticks
    pairs = [(each, again[each.time_unix_us]) for each in published if each.time_unix_us in again]
    mine, theirs = (
        np.array([one.q_ned_frd for one in column]) for column in zip(*pairs, strict=True)
    )
    boot_us = np.array([a.time_boot_us for a, _ in pairs], dtype=float)
    inside = (boot_us > replayed.sampled_us[0]) & (boot_us < replayed.sampled_us[-1])
    age_ms = np.array([a.age_ms - b.age_ms for a, b in pairs])
    times_us = np.array([a.time_boot_us - b.time_boot_us for a, b in pairs])
    return {
        "published": len(published),
        "compared": len(pairs),
        "samples replayed": len(replayed.sampled_us),
        "state": figures(mine, theirs),
        "ahead": figures(mine[inside], interpolated(replayed, boot_us[inside])),
        "of one sample": float(np.mean(np.abs(age_ms) < 0.01)),
        "times differ ms": float(np.abs(times_us).max()) / 1e3,
    }


def figures(some: Array, others: Array) -> list[float]:
    """Angles between attitudes: RMS, 99th percentile, largest."""
    angles = errors_deg(some, others)[:, 0]
    return [*np.atleast_1d(rms(angles)), *np.percentile(angles, (99, 100)).tolist()]


def main() -> int:
    made = parser(__doc__)
    made.add_argument("log", type=Path, nargs="?")
    made.add_argument("--rate", type=float, default=100.0, metavar="HZ")
    made.add_argument("--from", dest="begin_s", type=float, default=0.0, metavar="S")
    made.add_argument("--seconds", type=float, default=1e9, metavar="S")
    made.add_argument("--skip", type=float, default=20.0, metavar="S", help="of the beginning")
    options = made.parse_args()
    if options.smoke:
        options.log, options.seconds, options.skip = options.log or SHORT_LOG, 6.0, 2.0
    if options.log is None:
        made.error("give a LOG, or --smoke")
    frames = list(chosen_frames(options.log, options.begin_s, options.seconds))
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder, "record.tlog")
        published, counts = play(frames, record, options.rate)
        row = {**compared(published, record, options.skip), **counts}
    show({"live against the replay of its record, degrees": [row]}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
