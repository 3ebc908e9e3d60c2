"""What one sample and one attitude cost the live service, step by step.

python benchmarks/live_stages.py [--vehicles N] [--json]

The service's own parts on one thread, without sockets, on the datagrams of simulated vehicles at
50 Hz: microseconds a sample (or attitude), caches warm. In the service threads sleep in between
and wake up to cold caches, which alone makes everything a third dearer.
"""

import argparse
import gc
import json
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec

from drivers.events import Event
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.records import Published
from service.warm_up import warm_up

RATE_HZ = 50.0
PERIOD_US = 20_000
WARM_UP_TICKS = 50  # vehicles appear and align
TICKS = 150
START_UNIX_US = 1_700_000_000_000_000
PEER = "127.0.0.1:14550"


class Stages:
    """Adds up the time spent in each step."""

    def __init__(self) -> None:
        self.ns: defaultdict[str, int] = defaultdict(int)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Count what is done within."""
        begin_ns = time.perf_counter_ns()
        yield
        self.ns[name] += time.perf_counter_ns() - begin_ns


def main() -> None:
    options = _options()
    result = measure(options.vehicles)
    if options.json:
        print(json.dumps(result))
        return
    for name, cost_us in result.items():
        print(f"{name:40s}{cost_us:8.2f} us")


def measure(vehicles: int) -> dict[str, float]:
    """Microseconds a sample and attitude of each step, and their sum."""
    profile = load_profile("imu")
    warm_up(profile, None)
    senders = [
        SimulatedAutopilot(VehicleOptions(rate_hz=RATE_HZ), each + 1) for each in range(vehicles)
    ]
    rows = [[s.advance(s.due_us, 0) for s in senders] for _ in range(WARM_UP_TICKS + TICKS)]
    reader, gate, decoder = FrameReader(), FrameGate(Policy()), MavlinkDecoder(references=False)
    pipeline, encode = Pipeline(profile), msgspec.json.Encoder().encode
    stages = Stages()
    gc.freeze()
    for number, datagrams in enumerate(rows):
        if number == WARM_UP_TICKS:
            stages.ns.clear()
        now_us = START_UNIX_US + number * PERIOD_US
        with stages.step("frames: bounds, checksums"):
            frames = [frame for data in datagrams for frame in reader.feed(data)]
        with stages.step("gate: systems, senders"):
            frames = [frame for frame in frames if gate.lets_in(frame, PEER, now_us)]
        events: list[Event] = []
        with stages.step("decoding, clock, checks"):
            for frame in frames:
                events += decoder.events(frame, now_us)
        with stages.step("estimator, health, host clock"):
            for event in events:
                pipeline.handle(event)
        with stages.step("attitude, record"):
            outputs = pipeline.tick(now_us + PERIOD_US // 2)
        with stages.step("JSON"):
            for output in outputs:
                if isinstance(output, Published):
                    encode(output.record)
    costs_us = {name: round(ns / 1e3 / TICKS / vehicles, 2) for name, ns in stages.ns.items()}
    return {**costs_us, "sum": round(sum(costs_us.values()), 2)}


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    main()
