"""Readings of ordinary sensors of a true motion, and what can go wrong with them for a while."""

from collections.abc import Callable
from itertools import product
from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
from pygeomag import GeoMag

from estimator.geometry.rotations import rotate_inverse
from estimator.types import Floats
from tests.truth.motions import DURATION_S, FINE_HZ, TIME_S, Motion

YEAR = 2025.8
VIBRATION_HZ = 73.3  # beside every multiple of the streams' rates
Flags = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


class Place(NamedTuple):
    """Where it happens."""

    latitude_deg: float = 47.3977
    longitude_deg: float = 8.5456
    altitude_m: float = 488.0


class EarthField(NamedTuple):
    """The magnetic field of a place."""

    declination_rad: float
    ned_gauss: tuple[float, float, float]


class Readings(NamedTuple):
    """What one stream of IMU messages contains, and the velocities beside it; N samples."""

    time_s: Floats  # true time
    boot_s: Floats  # by the vehicle's clock
    stamp_s: Floats  # by the IMU message's own stamp
    gyr_rad_s: Floats  # (N, 3), FRD
    acc_m_s2: Floats  # (N, 3), FRD
    mag_gauss: Floats  # (N, 3), FRD
    velocity_m_s: Floats  # (N, 3), NED


class Fault(NamedTuple):
    """What goes wrong. ``size`` is in the kind's own unit; ``axis`` 0, 1, 2 is x, y, z."""

    kind: str = "none"
    axis: int = 0
    size: float = 0.0
    begin_s: float = 40.0
    end_s: float = DURATION_S

    def __str__(self) -> str:
        axis = "xyz"[self.axis] if self.kind.startswith(("gyroscope", "magnetometer o")) else ""
        size = f"{self.size:g}" if self.size else ""
        return " ".join(filter(None, (self.kind, axis, size)))


HEALTHY = Fault(begin_s=0.0)


def earth_field(place: Place) -> EarthField:
    """The World Magnetic Model's field at a place."""
    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")
    found = model.calculate(place.latitude_deg, place.longitude_deg, 1e-3 * place.altitude_m, YEAR)
    declination, dip, strength = radians(found.d), radians(found.i), 1e-5 * found.f
    level = strength * cos(dip)
    ned = (level * cos(declination), level * sin(declination), strength * sin(dip))
    return EarthField(declination, ned)


def sense(motion: Motion, rate_hz: float, field: EarthField, seed: int) -> Readings:
    """Healthy readings at ``rate_hz``."""
    rng = np.random.default_rng([seed, 1])
    at = np.round(np.arange(0.0, DURATION_S, 1.0 / rate_hz) * FINE_HZ).astype(int)
    at = at[at < len(TIME_S)]
    moving = np.linalg.norm(motion.velocity_m_s[at], axis=1) > 0.05

    def with_errors(signal: Floats, noise: float, bias: float, shaken: float) -> Floats:
        sigma = np.hypot(noise, shaken * moving)[:, None]
        scale = 1.0 + 0.003 * rng.standard_normal(3)
        errors = bias * rng.standard_normal(3) + sigma * rng.standard_normal(signal.shape)
        return np.asarray(scale * signal + errors)

    gyr = with_errors(motion.rate_rad_s[at], 0.002, 0.005, motion.gyr_vibration_rad_s)
    acc = with_errors(motion.force_m_s2[at], 0.03, 0.05, motion.acc_vibration_m_s2)
    mag = with_errors(rotate_inverse(motion.q_ned_frd[at], field.ned_gauss), 0.003, 0.003, 0.0)
    keep = np.exp(-1.0 / (5.0 * rate_hz))  # a filter's velocity drifts about within seconds
    slow = np.zeros((len(at), 3))
    for k in range(1, len(at)):
        slow[k] = keep * slow[k - 1] + 0.1 * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    velocity = motion.velocity_m_s[at] + slow * (0.2 + 0.8 * moving[:, None])
    boot_s = 5.0 + TIME_S[at]
    return Readings(TIME_S[at], boot_s, boot_s, gyr, acc, mag, velocity)


def impair(healthy: Readings, fault: Fault, seed: int) -> Readings:
    """The readings with the fault."""
    is_wrong = (healthy.time_s >= fault.begin_s) & (healthy.time_s < fault.end_s)
    rng = np.random.default_rng([seed, 2])
    if fault.kind == "none" or not is_wrong.any():
        return healthy
    return KINDS[fault.kind](healthy, fault, is_wrong, rng)


Kind = Callable[[Readings, Fault, Flags, np.random.Generator], Readings]
# What becomes of readings (M,) of one axis, or (M, 3), at those times (M,).
Change = Callable[[Floats, Fault, Floats, np.random.Generator], Floats]


def _of(sensor: str, change: Change, *, every: bool = False) -> Kind:
    """A fault of a sensor, of the fault's axis alone or of ``every`` one."""

    def apply(r: Readings, fault: Fault, wrong: Flags, rng: np.random.Generator) -> Readings:
        values = getattr(r, sensor).copy()
        at = wrong if every else (wrong, fault.axis)
        values[at] = change(values[at], fault, r.time_s[wrong], rng)
        return r._replace(**{sensor: values})

    return apply


CHANGES: dict[str, Change] = {
    "first": lambda v, *_: np.broadcast_to(v[0], v.shape),
    "offset": lambda v, fault, *_: v + fault.size,
    "scaled": lambda v, fault, *_: v * fault.size,
    "growing": lambda v, fault, time_s, _: v + fault.size * (time_s - fault.begin_s),
    "noisy": lambda v, fault, _, rng: v + fault.size * rng.standard_normal(len(v)),
    # one sample alone, as at a motor's start
    "knocked": lambda v, fault, *_: v + fault.size * (np.arange(len(v)) == 0),
    # no field, as a message without a compass has it
    "absent": lambda v, *_: 0.0 * v,
}


def _saturated(v: Floats, fault: Fault, *_: object) -> Floats:
    """The end of the range is a share of the largest reading."""
    end = fault.size * float(np.max(np.abs(v)))
    return np.clip(v, -end, end)


def _vibrating(v: Floats, fault: Fault, time_s: Floats, rng: np.random.Generator) -> Floats:
    swing = np.sin(2 * np.pi * VIBRATION_HZ * time_s[:, None] + rng.uniform(0, 6.3, 3))
    return np.asarray(v + fault.size * rng.uniform(0.5, 1.5, v.shape) * swing * (0.5, 0.5, 1.0))


def _turned(v: Floats, fault: Fault, *_: object) -> Floats:
    """About the third axis, as a compass whose orientation parameter is wrong."""
    c, s = cos(radians(fault.size)), sin(radians(fault.size))
    return np.asarray(v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def _other_pace(r: Readings, fault: Fault, wrong: Flags, _: np.random.Generator) -> Readings:
    """The vehicle's whole clock runs at another pace."""
    steps = np.diff(r.boot_s, prepend=r.boot_s[0]) * np.where(wrong, fault.size, 1.0)
    boot_s = r.boot_s[0] + np.cumsum(steps)
    return r._replace(boot_s=boot_s, stamp_s=boot_s)


KINDS: dict[str, Kind] = {
    "gyroscope stuck": _of("gyr_rad_s", CHANGES["first"]),
    "gyroscope offset": _of("gyr_rad_s", CHANGES["offset"]),
    "gyroscope scale": _of("gyr_rad_s", CHANGES["scaled"]),
    "gyroscope noise": _of("gyr_rad_s", CHANGES["noisy"]),
    "gyroscope saturated": _of("gyr_rad_s", _saturated),
    "gyroscope drift": _of("gyr_rad_s", CHANGES["growing"]),
    "accelerometer knock": _of("acc_m_s2", CHANGES["knocked"]),
    "accelerometer offset": _of("acc_m_s2", CHANGES["offset"]),
    "accelerometer growing": _of("acc_m_s2", CHANGES["growing"]),
    "accelerometer vibration": _of("acc_m_s2", _vibrating, every=True),
    "magnetometer offset": _of("mag_gauss", CHANGES["offset"]),
    "magnetometer frozen": _of("mag_gauss", CHANGES["first"], every=True),
    "magnetometer turned": _of("mag_gauss", _turned, every=True),
    "magnetometer absent": _of("mag_gauss", CHANGES["absent"], every=True),
    "velocity scale": _of("velocity_m_s", CHANGES["scaled"], every=True),
    "velocity turned": _of("velocity_m_s", _turned, every=True),
    "clock unit": _of("stamp_s", CHANGES["scaled"], every=True),  # of the IMU's own stamp alone
    "clock pace": _other_pace,
}


def listed_faults() -> list[Fault]:
    """One of each kind and axis."""
    sized = (("stuck", 0.0), ("offset", 0.1), ("offset", 0.5), ("scale", 2.0), ("noise", 0.3))
    of_axes = product((*sized, ("saturated", 0.5)), range(3))
    return [
        HEALTHY,
        *(Fault(f"gyroscope {kind}", axis, size) for (kind, size), axis in of_axes),
        Fault("accelerometer offset", 0, 3.0, end_s=60.0),
        Fault("accelerometer growing", 1, 0.3, end_s=60.0),
        Fault("accelerometer vibration", 0, 80.0, end_s=60.0),
        Fault("magnetometer offset", 1, 0.2, end_s=60.0),
        Fault("magnetometer frozen"),
        Fault("magnetometer absent", begin_s=0.0),
        Fault("magnetometer turned", 0, 90.0, begin_s=0.0),
        Fault("magnetometer turned", 0, 180.0, begin_s=0.0),
        Fault("magnetometer offset", 0, -0.3, begin_s=0.0),
        Fault("accelerometer knock", 0, 25.0, begin_s=12.0),
        Fault("gyroscope offset", 0, 0.07, begin_s=0.0),
        Fault("velocity scale", 0, 2.0),
        Fault("velocity turned", 0, 90.0),
        Fault("clock unit", 0, 1e-3, begin_s=0.0),
        Fault("clock pace", 0, 1e-3),
        Fault("clock pace", 0, 1.03, begin_s=0.0),
    ]


def drawn_fault(rng: np.random.Generator) -> Fault:
    """Any kind on any axis, its size and time at random."""
    sizes = {
        "gyroscope offset": rng.uniform(0.1, 0.5),
        "gyroscope scale": rng.uniform(0.3, 3.0),
        "gyroscope noise": rng.uniform(0.05, 0.5),
        "gyroscope saturated": rng.uniform(0.2, 0.8),
        "gyroscope drift": rng.uniform(2e-5, 2e-4),
        "accelerometer knock": rng.uniform(10.0, 50.0),
        "accelerometer offset": rng.uniform(1.0, 5.0),
        "accelerometer growing": rng.uniform(0.1, 0.5),
        "accelerometer vibration": rng.uniform(20.0, 120.0),
        "magnetometer offset": rng.uniform(0.05, 0.4),
        "magnetometer turned": rng.uniform(20.0, 180.0),
        "velocity scale": rng.uniform(0.3, 3.0),
        "velocity turned": rng.uniform(20.0, 180.0),
        "clock unit": 1e-3,
        "clock pace": rng.choice((1e-3, 0.1, 0.95, 1.05, 10.0)),
    }
    kind = str(rng.choice([*KINDS, "none"]))
    is_constant = kind in ("clock unit", "magnetometer turned", "magnetometer absent")
    begin_s = 0.0 if is_constant else float(rng.uniform(15.0, 50.0))
    end_s = begin_s + float(rng.uniform(10.0, 30.0)) if rng.random() < 0.5 else DURATION_S
    size = float(sizes.get(kind, 0.0)) * (rng.choice((-1.0, 1.0)) if "offset" in kind else 1.0)
    if is_constant:
        end_s = DURATION_S
    axis, size = int(rng.integers(3)), float(f"{size:.3g}")
    return Fault(kind, axis, size, round(begin_s, 1), round(end_s, 1))
