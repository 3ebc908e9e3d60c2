"""What is flown in simulation, and what goes wrong; magnitudes are drawn anew for each seed."""

import tempfile
from collections.abc import Callable
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
        vehicle_type=GROUND_ROVER if motion in ("rover", "car") else QUADROTOR,
    )


def bad_compass(flight: Flight, rng: Rng) -> Flight:
    """10 to 60 mGauss of hard iron, and as much from the motors."""
    iron, current = rng.uniform(0.01, 0.06, 2)
    return flight._replace(sensors=Sensors(hard_iron=float(iron), current=float(current)))


def slow_filters(flight: Flight, _: Rng) -> Flight:
    """The low-passes that ArduPilot gives a rover."""
    return flight._replace(sensors=flight.sensors._replace(gyr_hz=4.0, acc_hz=10.0))


def cabin(flight: Flight, rng: Rng) -> Flight:
    """A poor IMU between a car's iron, and a receiver's velocity ten times a second."""
    turn_rad, scale = float(rng.uniform(-1.2, 1.2)), float(rng.uniform(0.6, 1.4))
    return flight._replace(
        sensors=Sensors(
            gyr=0.01,
            gyr_bias=0.04,
            acc=0.3,
            acc_bias=0.2,
            mag=0.01,
            field_turn_rad=turn_rad,
            field_scale=scale,
            gyr_hz=40.0,
            acc_hz=40.0,
        ),
        link=Link(period_s=0.01),
    )


def at_4_hz(flight: Flight, _: Rng) -> Flight:
    """The rate that a ground station asks for."""
    return flight._replace(link=Link(period_s=0.25))


def over_wifi(flight: Flight, _: Rng) -> Flight:
    """A fast stream that stands still for seconds, again and again."""
    return flight._replace(link=flight.link._replace(holes=6, hole_s=(1.0, 5.0)))


def over_radio(hz: float) -> Callable[[Flight, Rng], Flight]:
    """A ground station's radio link: uneven, with losses and holes; receivers say no accuracy."""

    def change(flight: Flight, rng: Rng) -> Flight:
        link = Link(period_s=1.0 / hz, jitter=0.2, loss=0.05, holes=3)
        receiver = flight.receiver._replace(says_m_s=0.0)
        current = float(rng.uniform(0.0, 0.03))
        sensors = Sensors(acc=0.3, hard_iron=0.02, current=current)
        return flight._replace(link=link, receiver=receiver, sensors=sensors)

    return change


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
    "slow filters": Case(("rover",), slow_filters),
    "cabin": Case(("car",), cabin),
    "4 Hz": Case(VEHICLES, at_4_hz),
    "wifi": Case(VEHICLES, over_wifi),
    **{f"radio at {hz:g} Hz": Case(VEHICLES, over_radio(hz)) for hz in (1.0, 2.5, 4.0)},
}


def write(path: Path, case: str, motion_name: str, seed: int, duration_s: float) -> None:
    """Fly, and write the telemetry log."""
    rng = np.random.default_rng(77_000 + seed)
    flight = CASES[case].change(ordinary_flight(rng, motion_name), rng)
    record(path, integrate(MOTIONS[motion_name](seed), duration_s), flight, seed)


def recorded(case: str, motion_name: str, seed: int, duration_s: float) -> Events:
    """The same, read as any log."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        write(path, case, motion_name, seed, duration_s)
        return read(path)
