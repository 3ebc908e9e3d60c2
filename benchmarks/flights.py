"""Simulated flights with an autopilot's stream, with and without velocity.

A plane with banks of 60 degrees, loops and rolls, and a copter that is thrown
about. The stream has what real ones have: an IMU low-passed at 20 Hz and
truncated, a field averaged to 10 Hz, sample times that miss the grid, and
velocity with slow errors as an autopilot's filter makes them. Nothing is shared with the
estimator but quaternion algebra, so it says how the aiding does on flights it
was not made on.

example: python benchmarks/flights.py --json --seeds 0-2
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.quaternion import exp, multiply, normalize
from estimator.profile import load_profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample, VelocitySample

Floats = NDArray[np.float64]

FINE_HZ = 400
DECLINATION_DEG = 12.0
DIP_DEG = 62.0
FIELD_GAUSS = 0.5
REST_S = 30.0
SKIP_S = 40.0
DURATION_S = 240.0


class Motion(NamedTuple):
    """Truth at ``FINE_HZ``: attitude (N, 4), body rate (N, 3), velocity in NED (N, 3)."""

    attitude: Floats
    rate: Floats
    velocity: Floats


class Sensors(NamedTuple):
    """One sigma each, SI and gauss; ``current`` is the field of the motors in a hover."""

    gyr: float
    gyr_bias: float
    acc: float
    acc_bias: float
    mag: float
    hard_iron: float
    current: float
    velocity: float
    velocity_tau_s: float


GOOD = Sensors(0.003, 0.003, 0.15, 0.05, 0.004, 0.0, 0.0, 0.15, 5.0)
NOISY = Sensors(0.01, 0.003, 0.5, 0.05, 0.01, 0.015, 0.03, 0.3, 5.0)


def rotations(q: Floats) -> Floats:
    """(N, 3, 3) of q_ned_frd (N, 4)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def turned(q: tuple[float, ...], rate: Floats) -> tuple[float, ...]:
    step = exp(tuple((rate / FINE_HZ).tolist()))
    return normalize(multiply(q, step))  # type: ignore[arg-type]


def roll_and_pitch(R: Floats) -> tuple[float, float]:
    return float(np.arctan2(R[2, 1], R[2, 2])), float(-np.arcsin(np.clip(R[2, 0], -1.0, 1.0)))


PLANE_LEGS = ("bank 60", "loop", "straight", "bank -60", "roll", "bank 30", "bank -45", "climb")


def plane(seed: int) -> Motion:
    """Rest, take-off run, then legs at random; speed falls in climbs, gusts shake it."""
    rng = np.random.default_rng(seed)
    n, dt = int(DURATION_S * FINE_HZ), 1.0 / FINE_HZ
    q = exp((0.0, 0.0, float(rng.uniform(-np.pi, np.pi))))
    speed, leg, left = 0.0, "rest", REST_S
    rate, gust, attack = np.zeros(3), np.zeros(3), 0.0
    out = Motion(np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3)))
    for k in range(n):
        R = rotations(np.array([q]))[0]
        roll, pitch = roll_and_pitch(R)
        left -= dt
        if left <= 0.0:
            leg = "run" if leg == "rest" else str(rng.choice(PLANE_LEGS))
            left = {"run": 15.0, "loop": 2.0 * np.pi, "roll": 4.0}.get(leg, rng.uniform(6.0, 20.0))
        if leg == "run":
            speed = min(speed + 3.0 * dt, 22.0)
        elif leg != "rest":
            pull = -0.35 * STANDARD_GRAVITY_M_S2 * np.sin(pitch) + 0.3 * (24.0 - speed)
            speed = max(speed + pull * dt, 12.0)
        if leg not in ("rest", "run"):
            gust += -gust / 0.7 * dt
            gust += np.sqrt(2.0 / 0.7 * dt) * rng.standard_normal(3) * (0.15, 0.08, 0.05)
        rate += (_plane_rate(leg, roll, pitch, speed) - rate) * dt / 0.15
        turning = rate + gust if leg != "rest" else np.zeros(3)
        attack += (0.04 + 0.03 * abs(turning[1]) - attack) * dt / 0.3
        angle = attack * min(1.0, max(0.0, (speed - 12.0) / 4.0))
        out.attitude[k], out.rate[k] = q, turning
        out.velocity[k] = R @ (speed * np.array([np.cos(angle), 0.03 * gust[2], np.sin(angle)]))
        q = turned(q, turning)  # type: ignore[assignment]
    return out


def _plane_rate(leg: str, roll: float, pitch: float, speed: float) -> Floats:
    """The body rate that the leg asks for: a coordinated turn towards its bank and pitch."""
    if leg == "loop":
        return np.array([0.0, 1.0, 0.0])
    if leg == "roll":
        return np.array([np.pi / 2.0, 0.0, 0.0])
    bank = np.radians(float(leg.split()[1])) if leg.startswith("bank") else 0.0
    climb = np.radians({"climb": 12.0, "run": 4.0}.get(leg, 0.0)) if speed > 15.0 else 0.0
    up = np.clip(1.5 * (climb - pitch), -0.6, 0.6)
    steep = np.tan(np.clip(roll, -1.2, 1.2))
    yaw = STANDARD_GRAVITY_M_S2 * steep / speed if speed > 14.0 else 0.0
    return np.array(
        [
            np.clip(2.0 * (bank - roll), -1.5, 1.5) - yaw * np.sin(pitch),
            up * np.cos(roll) + yaw * np.sin(roll) * np.cos(pitch),
            -up * np.sin(roll) + yaw * np.cos(roll) * np.cos(pitch),
        ]
    )


def copter(seed: int) -> Motion:
    """Rest, then tilts of up to 45 degrees and turns at random, braked by drag."""
    rng = np.random.default_rng(seed)
    n, dt = int(DURATION_S * FINE_HZ), 1.0 / FINE_HZ
    q = exp((0.0, 0.0, float(rng.uniform(-np.pi, np.pi))))
    gravity = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    velocity, rate, wanted, left, flying = np.zeros(3), np.zeros(3), np.zeros(3), REST_S, False
    out = Motion(np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3)))
    for k in range(n):
        R = rotations(np.array([q]))[0]
        roll, pitch = roll_and_pitch(R)
        left -= dt
        if left <= 0.0:
            flying, left = True, rng.uniform(1.5, 8.0)
            lean = rng.uniform(-0.8, 0.8, 2) * (rng.random() > 0.25)
            wanted = np.array([*lean, rng.uniform(-1.5, 1.5) * (rng.random() < 0.5)])
        if flying:
            drift = R.T @ velocity
            asked = np.array(
                [
                    np.clip(5.0 * (wanted[0] - 0.02 * drift[1] - roll), -4.0, 4.0),
                    np.clip(5.0 * (wanted[1] + 0.02 * drift[0] - pitch), -4.0, 4.0),
                    wanted[2],
                ]
            )
            rate = rate + (asked - rate) * dt / 0.08 + 0.18 * np.sqrt(dt) * rng.standard_normal(3)
            hover = STANDARD_GRAVITY_M_S2 / max(0.4, np.cos(roll) * np.cos(pitch))
            force = R @ np.array([0.0, 0.0, -hover - 0.6 * velocity[2]]) - 0.25 * velocity
            velocity = velocity + (force + gravity) * dt
        out.attitude[k], out.rate[k], out.velocity[k] = q, rate, velocity
        q = turned(q, rate)  # type: ignore[assignment]
    return out


class Stream(NamedTuple):
    """IMU samples, reports with the index of the sample before them, truth at the samples."""

    samples: list[ImuSample]
    reports: list[tuple[int, VelocitySample]]
    truth: Floats


def streamed(motion: Motion, sensors: Sensors, rate_hz: float, seed: int) -> Stream:
    """What an autopilot makes of a motion."""
    rng = np.random.default_rng(1000 + seed)
    R = rotations(motion.attitude)
    n = len(R)
    gravity = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    force = np.gradient(motion.velocity, 1.0 / FINE_HZ, axis=0) - gravity
    acc = np.einsum("nji,nj->ni", R, force)
    noise = np.sqrt(FINE_HZ / 44.0)  # so much is left of it behind the low-pass

    def sensed(signal: Floats, sigma: float, bias: float) -> Floats:
        raw = signal + bias * rng.standard_normal(3) + sigma * noise * rng.standard_normal((n, 3))
        b, a = butter(2, 20.0, fs=FINE_HZ)
        start = raw[:50].mean(axis=0)
        smooth: Floats = lfilter(b, a, raw - start, axis=0) + start
        return smooth

    gyr = sensed(motion.rate, sensors.gyr, sensors.gyr_bias)
    mag = _averaged_field(R, acc, sensors, rng)
    felt = sensed(acc, sensors.acc, sensors.acc_bias)
    velocity = motion.velocity + _slow_error(n, sensors, rng)
    at = np.arange(0.5 * FINE_HZ, n, FINE_HZ / rate_hz).astype(int)
    taken = at - rng.integers(0, 2, len(at))  # a sample is up to 2.5 ms older than its stamp
    every = max(1, round(rate_hz / 10.0))
    samples, reports = [], []
    last = None
    for k, (i, j) in enumerate(zip(at.tolist(), taken.tolist(), strict=True)):
        field = _truncated(mag[j], 1e-3)
        time_us = round(1e6 * i / FINE_HZ)
        fresh = field != last
        last = field
        turn, push = _truncated(gyr[j], 1e-3), _truncated(felt[j], STANDARD_GRAVITY_M_S2 * 1e-3)
        samples.append(ImuSample(time_us, turn, push, field if fresh else (0.0, 0.0, 0.0), fresh))
        if k % every == 0:
            said = _truncated(velocity[i], 0.01)
            reports.append((k, VelocitySample(time_us, said, True, 0.3)))
    return Stream(samples, reports, motion.attitude[at])


def _averaged_field(R: Floats, acc: Floats, sensors: Sensors, rng: np.random.Generator) -> Floats:
    """Means over 0.1 s, each held over the next."""
    dip, declination = np.radians(DIP_DEG), np.radians(DECLINATION_DEG)
    north = (np.cos(dip) * np.cos(declination), np.cos(dip) * np.sin(declination), np.sin(dip))
    field = np.einsum("nji,j->ni", R, FIELD_GAUSS * np.array(north))
    field += sensors.hard_iron * rng.standard_normal(3)
    load = np.clip(-acc[:, 2:] / STANDARD_GRAVITY_M_S2, 0.0, 3.0)
    field += sensors.current * load * rng.standard_normal(3)
    block = FINE_HZ // 10
    means = field[: len(field) // block * block].reshape(-1, block, 3).mean(axis=1)
    means += sensors.mag * rng.standard_normal(means.shape)
    return np.repeat(np.vstack([means[:1], means]), block, axis=0)


def _slow_error(n: int, sensors: Sensors, rng: np.random.Generator) -> Floats:
    """First-order noise, smoothed: a filter's velocity has no steps."""
    keep = np.exp(-1.0 / (FINE_HZ * sensors.velocity_tau_s))
    white = sensors.velocity * np.sqrt(1.0 - keep * keep) * rng.standard_normal((n, 3))
    slow = lfilter([1.0], [1.0, -keep], white, axis=0)
    b, a = butter(1, 0.5, fs=FINE_HZ)
    return np.asarray(lfilter(b, a, slow, axis=0))


def _truncated(vector: Floats, unit: float) -> tuple[float, float, float]:
    x, y, z = (np.trunc(vector / unit) * unit).tolist()
    return (x, y, z)


def score(stream: Stream, *, with_velocity: bool) -> dict[str, float]:
    """RMS errors in degrees and coverage, behind ``SKIP_S``."""
    north = {"reference": {"declination_deg": DECLINATION_DEG}}
    estimator = Estimator(merge_profile(load_profile("imu"), north))
    behind = dict(stream.reports) if with_velocity else {}
    attitudes = []
    for k, sample in enumerate(stream.samples):
        estimator.update(sample)
        attitudes.append(estimator.attitude(sample.time_us))
        if k in behind:
            estimator.update_velocity(behind[k])
    counted = np.array([s.time_us for s in stream.samples]) >= SKIP_S * 1e6
    errors = batch_angle_errors(np.array([a.q_ned_frd for a in attitudes]), stream.truth)[counted]
    sigma_i = np.array([a.sigma_inclination_rad for a in attitudes])[counted]
    sigma_h = np.array([a.sigma_heading_rad for a in attitudes])[counted]
    total, heading, inclination = (float(np.degrees(rms(errors[:, i]))) for i in range(3))
    return {
        "total_deg": total,
        "heading_deg": heading,
        "inclination_deg": inclination,
        "coverage_inclination": float(np.mean(errors[:, 2] <= sigma_i)),
        "coverage_heading": float(np.mean(errors[:, 1] <= sigma_h)),
    }


MOTIONS: dict[str, Callable[[int], Motion]] = {"plane": plane, "copter": copter}
SENSORS = {"good": GOOD, "noisy": NOISY}
RATES_HZ = (50.0, 4.0)


def main() -> None:
    """Fly all, print a line or an object each."""
    parser = argparse.ArgumentParser(description="Simulated flights with and without velocity.")
    parser.add_argument("--seeds", default="0-2", metavar="A-B")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    results = []
    for name, fly in MOTIONS.items():
        for seed in range(int(first), int(last or first) + 1):
            motion = fly(seed)
            for quality, sensors in SENSORS.items():
                for rate_hz in RATES_HZ:
                    stream = streamed(motion, sensors, rate_hz, seed)
                    aided, unaided = (score(stream, with_velocity=v) for v in (True, False))
                    flight = {"motion": name, "seed": seed, "sensors": quality, "rate_hz": rate_hz}
                    results.append({**flight, "aided": aided, "unaided": unaided})
                    if not options.json:
                        print(_line(results[-1]), flush=True)
    if options.json:
        print(json.dumps(results))


def _line(result: dict[str, object]) -> str:
    aided, unaided = result["aided"], result["unaided"]
    assert isinstance(aided, dict)
    assert isinstance(unaided, dict)
    flight = f"{result['motion']} {result['seed']} {result['sensors']} {result['rate_hz']:.0f} Hz"
    return (
        f"{flight:22s} total {aided['total_deg']:5.2f} heading {aided['heading_deg']:5.2f} "
        f"inclination {aided['inclination_deg']:5.2f} under sigma "
        f"{aided['coverage_inclination']:.2f} {aided['coverage_heading']:.2f}; "
        f"without velocity {unaided['total_deg']:5.1f}"
    )


if __name__ == "__main__":
    main()
