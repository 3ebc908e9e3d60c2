"""Simulated flights with an autopilot's stream, through the whole chain as a log goes.

Planes, copters, quadplanes and rovers. Each flight is written as a telemetry log with what real
ones have (``flight_recorder.py``) and replayed through decoder and service. Nothing is shared
with the estimator but quaternion algebra and the field's model, so it says how the aiding does on
flights it was not made on. Magnitudes of the faults are drawn anew for each seed.

``--recording LOG`` takes a recording with the simulator's truth instead, and changes it.

example: python benchmarks/flights.py --json --seeds 100-102 --cases sound,compass
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from flight_changes import CHANGES
from flight_motions import FINE_HZ, MOTIONS, Motion
from flight_recorder import (
    START_UNIX_US,
    Filter,
    Flight,
    Link,
    Receiver,
    Sensors,
    Trouble,
    record,
)
from flight_score import line, score

from drivers.events import Event, Imu
from drivers.logs.open import open_log
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published

SKIP_S = 40.0
TICK_US = 20_000
VEHICLES = ("plane", "copter", "calm copter", "quadplane", "rover")
CLEAN = Sensors(gyr=3e-4, acc=0.01, mag=0.001, hard_iron=0.0, acc_bias=0.0)
NOISY = Sensors(gyr=0.01, acc=0.5, mag=0.01, hard_iron=0.02, current=0.02)
PERFECT = Receiver(late_s=0.085, noise_m_s=0.01, slow_m_s=0.02, says_m_s=0.04)

Rng = np.random.Generator


class Case(NamedTuple):
    """What is flown, and what goes wrong."""

    motions: tuple[str, ...]
    change: Callable[[Flight, Rng], Flight]


def ordinary_flight(rng: Rng, motion: str) -> Flight:
    """A flight with usual faults of both velocity sources, drawn at random."""
    return Flight(
        filter=Filter(ahead_s=float(rng.uniform(0.0, 0.025))),
        receiver=Receiver(
            late_s=float(rng.uniform(0.085, 0.2)),
            jitter_s=float(rng.choice((0.0, 0.03))),
            noise_m_s=float(rng.uniform(0.03, 0.15)),
            slow_m_s=float(rng.choice((0.03, 0.1, 0.2))),
            says_m_s=float(rng.choice((0.04, 0.3, 0.6))),
        ),
        link=Link(mixed=motion.startswith("plane")),
    )


def bad_compass(flight: Flight, rng: Rng) -> Flight:
    """10 to 60 mGauss of hard iron, and as much from the motors."""
    iron, current = rng.uniform(0.01, 0.06, 2)
    return flight._replace(sensors=Sensors(hard_iron=float(iron), current=float(current)))


def worse_compass(flight: Flight, _: Rng) -> Flight:
    """59 mGauss of hard iron, and half as much from the motors."""
    return flight._replace(sensors=Sensors(hard_iron=0.059, current=0.03))


def noisy_at_100_hz(flight: Flight, _: Rng) -> Flight:
    """Three times the sensors' noise, iron and current, in a companion's fast stream."""
    return flight._replace(sensors=NOISY, link=Link(period_s=0.01))


def at_4_hz(flight: Flight, _: Rng) -> Flight:
    """The rate that a ground station asks for."""
    return flight._replace(link=Link(period_s=0.25))


def over_radio(hz: float) -> Callable[[Flight, Rng], Flight]:
    """A ground station's radio link: uneven, with losses and holes; receivers say no accuracy."""

    def change(flight: Flight, rng: Rng) -> Flight:
        link = Link(period_s=1.0 / hz, jitter=0.2, loss=0.05, holes=3)
        receiver = flight.receiver._replace(says_m_s=0.0)
        current = float(rng.uniform(0.0, 0.03))
        sensors = Sensors(acc=0.3, hard_iron=0.02, current=current)
        return flight._replace(link=link, receiver=receiver, sensors=sensors)

    return change


def without_filter(hz: float) -> Callable[[Flight, Rng], Flight]:
    """The same while the autopilot's filter does without the receiver, which is beside walls."""

    def change(flight: Flight, rng: Rng) -> Flight:
        flight = over_radio(hz)(flight, rng)
        receiver = flight.receiver._replace(echoes_m_s=float(rng.choice((0.3, 1.0, 3.0))))
        return flight._replace(receiver=receiver, trouble=Trouble(is_unused=True))

    return change


SLOW_VEHICLES = ("plane", "copter", "calm copter", "rover", "carried")
CASES: dict[str, Case] = {
    "simulator": Case(VEHICLES, lambda f, _: f._replace(sensors=CLEAN, receiver=PERFECT)),
    "sound": Case(VEHICLES, lambda f, _: f),
    "noisy": Case(("plane", "copter"), lambda f, _: f._replace(sensors=NOISY)),
    "compass": Case(VEHICLES, bad_compass),
    "59 mGauss": Case(("copter", "calm copter"), worse_compass),
    "noisy at 100 Hz": Case(("copter",), noisy_at_100_hz),
    "satellites": Case(
        ("plane", "copter", "rover"),
        lambda f, _: f._replace(trouble=Trouble(lost=(90.0, 120.0), wrong=(150.0, 170.0))),
    ),
    "4 Hz": Case(VEHICLES, at_4_hz),
    "slowed down": Case(
        ("plane", "copter"), lambda f, _: f._replace(link=f.link._replace(bursts=True))
    ),
    "rough air at 4 Hz": Case(("plane in rough air",), at_4_hz),
    **{f"radio at {hz:g} Hz": Case(SLOW_VEHICLES, over_radio(hz)) for hz in (1.0, 2.5, 4.0)},
    **{
        f"receiver alone at {hz:g} Hz": Case(SLOW_VEHICLES, without_filter(hz))
        for hz in (1.0, 2.5, 4.0)
    },
    "stalls": Case(("copter",), lambda f, _: f._replace(link=f.link._replace(stalls_s=0.3))),
}


def live_error_deg(
    events: list[Event], motion: Motion, stalls: NDArray[np.float64], stall_s: float
) -> tuple[float, float]:
    """Errors of the attitudes published at ticks: their 99th percentile and their maximum."""
    pipeline, errors = Pipeline(load_profile("imu")), []
    tick_us = START_UNIX_US + int(SKIP_S * 1e6)
    for event in events:
        while isinstance(event, Imu) and event.arrival_us > tick_us:
            outputs = pipeline.tick(tick_us)
            t = 1e-6 * (tick_us - START_UNIX_US)
            for stall in stalls:
                t = max(min(t, stall), t - stall_s)
            i = min(round(t * FINE_HZ), len(motion.attitude) - 1)
            errors += [
                (output.record.q_ned_frd, tuple(motion.attitude[i]))
                for output in outputs
                if isinstance(output, Published) and isinstance(output.record, AttitudeRecord)
            ]
            tick_us += TICK_US
        pipeline.handle(event)
    published, true = (np.array(each) for each in zip(*errors, strict=True))
    total = np.degrees(batch_angle_errors(published, true)[:, 0])
    return float(np.percentile(total, 99.0)), float(total.max())


def fly(name: str, motion_name: str, seed: int) -> dict[str, Any]:
    """One flight, replayed with and without velocity."""
    rng = np.random.default_rng(77_000 + seed)
    flight = CASES[name].change(ordinary_flight(rng, motion_name), rng)
    motion = MOTIONS[motion_name](seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        stalls = record(path, motion, flight, seed)
        with open_log(path) as log:
            events = list(log)
    unaided = {"aiding": {"enabled": False}}
    result = {
        "case": name,
        "motion": motion_name,
        "seed": seed,
        "aided": score(events, skip_s=SKIP_S),
        "unaided": score(events, skip_s=SKIP_S, profile=unaided),
    }
    if name == "stalls":
        result["live_p99_deg"], result["live_max_deg"] = live_error_deg(
            events, motion, stalls, flight.link.stalls_s
        )
    return result


def fly_all(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All flights that are asked for, a line each."""
    first, _, last = options.seeds.partition("-")
    names = options.cases.split(",") if options.cases else list(CASES)
    results = []
    for name in names:
        for motion_name in CASES[name].motions:
            for seed in range(int(first), int(last or first) + 1):
                results.append(result := fly(name, motion_name, seed))
                if not options.json:
                    text = line(f"{name}, {motion_name} {seed}", result["aided"])
                    live = result.get("live_max_deg")
                    text += f"; without velocity {result['unaided'].total:.1f}"
                    print(text + (f"; live at most {live:.1f}" if live else ""), flush=True)
    return results


def replay_changes(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All changes of a recording, a line each."""
    with open_log(Path(options.recording)) as log:
        events = list(log)
    results = []
    for row in CHANGES:
        of = score(row.change(events), skip_s=row.skip_s)
        results.append({"change": row.name, "skip_s": row.skip_s, "aided": of})
        if not options.json:
            print(line(f"{row.name} (--skip {row.skip_s:.0f})", of), flush=True)
    return results


def main() -> None:
    """Fly all, or change a recording."""
    parser = argparse.ArgumentParser(description="Simulated flights with and without velocity.")
    parser.add_argument("--seeds", default="100-102", metavar="A-B")
    parser.add_argument("--cases", metavar="A,B", help=f"of: {', '.join(CASES)}")
    parser.add_argument("--recording", metavar="LOG", help="with the simulator's truth, changed")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = replay_changes(options) if options.recording else fly_all(options)
    if options.json:
        print(json.dumps([_plain(result) for result in results]))


def _plain(result: dict[str, Any]) -> dict[str, Any]:
    return {k: v._asdict() if isinstance(v, tuple) else v for k, v in result.items()}


if __name__ == "__main__":
    main()
