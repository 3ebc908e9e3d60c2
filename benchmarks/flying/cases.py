"""What is flown in simulation, and what goes wrong; magnitudes are drawn anew for each seed."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from flying.motions import MOTIONS, integrate
from flying.recorder import Filter, Flight, Link, Receiver, Sensors, Trouble, record
from flying.replayed import Events, read

QUADROTOR, GROUND_ROVER = 2, 10  # MAV_TYPE
SKIP_S, DURATION_S = 40.0, 240.0
VEHICLES = ("plane", "copter", "calm copter", "rover")
CLEAN = Sensors(gyr=3e-4, acc=0.01, mag=0.001, hard_iron=0.0, acc_bias=0.0)
NOISY = Sensors(gyr=0.01, acc=0.5, mag=0.01, hard_iron=0.02, current=0.02)
SLOW = Sensors(gyr_hz=4.0, acc_hz=10.0)
PERFECT = Receiver(late_s=0.085, noise_m_s=0.01, slow_m_s=0.02, reported_m_s=0.04)

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
            reported_m_s=float(rng.choice((0.04, 0.3, 0.6))),
        ),
        link=Link(mixed=motion.startswith("plane")),
        vehicle_type=GROUND_ROVER if motion in ("rover", "car") else QUADROTOR,
    )


def bad_compass(flight: Flight, rng: Rng) -> Flight:
    """10 to 60 mGauss of hard iron, and as much from the motors."""
    iron, current = rng.uniform(0.01, 0.06, 2)
    return flight._replace(sensors=Sensors(hard_iron=float(iron), current=float(current)))


def cabin(flight: Flight, rng: Rng) -> Flight:
    """A poor IMU between a car's iron, and a receiver's velocity ten times a second."""
    field = {"field_turn_rad": rng.uniform(-1.2, 1.2), "field_scale": rng.uniform(0.6, 1.4)}
    poor = {"gyr": 0.01, "gyr_bias": 0.04, "acc": 0.3, "acc_bias": 0.2, "mag": 0.01}
    sensors = Sensors(**poor, **field, gyr_hz=40.0, acc_hz=40.0)
    return flight._replace(sensors=sensors, link=Link(period_s=0.01))


CASES: dict[str, Case] = {
    "simulator": Case(VEHICLES, lambda f, _: f._replace(sensors=CLEAN, receiver=PERFECT)),
    "sound": Case(VEHICLES, lambda f, _: f),
    "noisy": Case(("plane", "copter"), lambda f, _: f._replace(sensors=NOISY)),
    "compass": Case(VEHICLES, bad_compass),
    "satellites": Case(
        ("plane", "copter", "rover"),
        lambda f, _: f._replace(trouble=Trouble(lost=(90.0, 120.0), wrong=(150.0, 170.0))),
    ),
    "vibration": Case(
        ("copter", "calm copter"),
        lambda f, _: f._replace(sensors=NOISY._replace(vibration=0.15), receiver=PERFECT),
    ),
    # the low-passes that ArduPilot gives a rover
    "slow filters": Case(("rover",), lambda f, _: f._replace(sensors=SLOW)),
    "cabin": Case(("car",), cabin),
    "4 Hz": Case(VEHICLES, lambda f, _: f._replace(link=Link(period_s=0.25))),
    # a fast stream that stands still for seconds, again and again
    "wifi": Case(VEHICLES, lambda f, _: f._replace(link=f.link._replace(holes=6))),
}


@contextmanager
def written(case: str, motion: str, seed: int, duration_s: float = DURATION_S) -> Iterator[Path]:
    """Fly; the telemetry log of it lasts as long as the context."""
    rng = np.random.default_rng(77_000 + seed)
    flight = CASES[case].change(ordinary_flight(rng, motion), rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{motion}-{seed}.tlog"
        record(path, integrate(MOTIONS[motion], seed, duration_s), flight, seed)
        yield path


def recorded(case: str, motion: str, seed: int, duration_s: float = DURATION_S) -> Events:
    """The same, read as any log."""
    with written(case, motion, seed, duration_s) as path:
        return read(path)
