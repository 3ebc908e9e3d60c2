"""A flight with known truth: level, then banked turns one way and the other, at constant speed.

Coordinated turns are what an unaided IMU cannot see through: the specific
force stays along the body's down axis however steep the bank.
"""

from dataclasses import dataclass

import numpy as np

from estimator.estimator import Estimator
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample, VelocitySample

SPEED_M_S = 20.0
LEVEL_S = 5.0
ROLL_TAU_S = 0.5
TURN_S = 12.0
FIELD_NED_GAUSS = (0.22, 0.0, 0.42)
FINE_STEP_S = 1e-3
IMU_LAG_STEPS = 12  # an autopilot's low-pass: what a sample shows is so old


@dataclass(frozen=True)
class Flight:
    """Samples, velocity reports (each with the index of the sample it comes behind), truth."""

    samples: list
    reports: list  # (index of the sample, VelocitySample)
    truth: list  # q_ned_frd at the samples


def banked_flight(
    seconds=60.0, rate_hz=50.0, report_hz=10.0, bank_rad=0.9, seed=0, velocity_noise=0.02
):
    """Seeded; a little sensor noise, reports at the samples' times."""
    rng = np.random.default_rng(seed)
    every = round(1.0 / (rate_hz * FINE_STEP_S))
    spacing = round(rate_hz / report_hz)
    samples, reports, truth = [], [], []
    roll = yaw = 0.0
    for step in range(round(seconds / FINE_STEP_S)):
        time_s = step * FINE_STEP_S
        turn = int((time_s - LEVEL_S) // TURN_S)
        wanted = 0.0 if time_s < LEVEL_S else (bank_rad if turn % 2 == 0 else -bank_rad)
        roll_rate = (wanted - roll) / ROLL_TAU_S
        yaw_rate = STANDARD_GRAVITY_M_S2 * np.tan(roll) / SPEED_M_S
        q = from_euler_rad(roll, 0.0, yaw)
        if step == 0 or (step + IMU_LAG_STEPS) % every == 0:
            gyr = (roll_rate, yaw_rate * np.sin(roll), yaw_rate * np.cos(roll))
            across = SPEED_M_S * yaw_rate
            force_ned = (-across * np.sin(yaw), across * np.cos(yaw), -STANDARD_GRAVITY_M_S2)
            reading = (
                _noisy(rng, gyr, 0.002),
                _noisy(rng, rotate_inverse(q, force_ned), 0.05),
                _noisy(rng, rotate_inverse(q, FIELD_NED_GAUSS), 0.001),
            )
        if step % every == 0:
            k = len(samples)
            samples.append(ImuSample(k * round(1e6 / rate_hz), *reading, True))
            truth.append(q)
            if k % spacing == 0:
                velocity = rotate(from_euler_rad(0.0, 0.0, yaw), (SPEED_M_S, 0.0, 0.0))
                report = _noisy(rng, velocity, velocity_noise)
                reports.append((k, VelocitySample(samples[-1].time_us, report, True, 0.3)))
        roll += roll_rate * FINE_STEP_S
        yaw += yaw_rate * FINE_STEP_S
    return Flight(samples, reports, truth)


def _noisy(rng, vector, sigma):
    return tuple(float(v) for v in np.array(vector) + sigma * rng.standard_normal(3))


def calibrated(profile, fixed_gain=None):
    """An estimator whose compass somebody vouches for."""
    estimator = Estimator(profile, fixed_gain)
    estimator.set_field_calibrated(True)
    return estimator


def flown(estimator, flight, reports=None, after=None):
    """Feed a flight; the attitudes after each sample. ``after(index)`` is called behind each."""
    behind = {}
    for k, report in flight.reports if reports is None else reports:
        behind.setdefault(k, []).append(report)
    attitudes = []
    for k, sample in enumerate(flight.samples):
        assert estimator.update(sample) is None
        attitudes.append(estimator.attitude(sample.time_us))
        for report in behind.get(k, []):
            assert estimator.update_velocity(report) is None
        if after is not None:
            after(k)
    return attitudes
