"""A flight with known truth: banked turns, which an unaided IMU cannot see through."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from estimator.aiding.phase import Phase
from estimator.estimator import Estimator
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.quaternion import rotate, rotate_inverse
from estimator.profile import load_profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, ImuSample, VelocitySample

SPEED_M_S = 20.0
LEVEL_S = 5.0
ROLL_TAU_S = 0.5
TURN_S = 12.0
FIELD_NED_GAUSS = (0.22, 0.0, 0.42)
FINE_STEP_S = 1e-3
IMU_LAG_STEPS = 12  # an autopilot's low-pass: what a sample shows is so old
# 0.01 deg instead of the WMM's: north is known, and the field points there.
TRUE_NORTH = {"reference": {"declination_deg": 0.01}}
ZURICH = (47.4, 8.5, 400.0, 1_700_000_000_000_000)
TOTAL, HEADING, INCLINATION = range(3)  # errors


@dataclass(frozen=True)
class Flight:
    """Samples, velocity reports (each with the index of the sample it comes behind), truth."""

    samples: list
    reports: list  # (index of the sample, VelocitySample)
    truth: list  # q_ned_frd at the samples


def banked_flight(seconds=60.0, rate_hz=50.0, report_hz=10.0, bank_rad=0.9, seed=0):
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
                report = _noisy(rng, velocity, 0.02)
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


def north_known(**sections):
    """A calibrated estimator by the profile imu, with north and these sections."""
    return calibrated(merge_profile(load_profile("imu"), {**TRUE_NORTH, **sections}))


def changed(flight, change):
    """The flight with ``change(sample, true attitude)`` in the place of each sample."""
    samples = [change(*each) for each in zip(flight.samples, flight.truth, strict=True)]
    return replace(flight, samples=samples)


def without_field(sample, _):
    return sample._replace(mag_gauss=ZERO_VEC3, has_mag=False)


def everywhere(*field_ned):
    """What changes a sample to one in this field, gauss."""
    return lambda s, q: s._replace(mag_gauss=rotate_inverse(q, field_ned), has_mag=True)


def errors_deg(flight, attitudes, begin_s=0.0, end_s=inf):
    """(N, 3) of the attitudes from one time to another."""
    times = np.array([s.time_us for s in flight.samples])
    estimates = np.array([a.q_ned_frd for a in attitudes])
    errors = np.degrees(batch_angle_errors(estimates, np.array(flight.truth)))
    return errors[(times >= begin_s * 1e6) & (times < end_s * 1e6)]


def rms_deg(kind, flight, attitudes, begin_s=0.0, end_s=inf):
    return rms(errors_deg(flight, attitudes, begin_s, end_s)[:, kind])


def taken_along(estimator, flight, samples):
    """The estimator after so many samples of a flight and their reports; velocity helps it."""
    behind = dict(flight.reports)
    for k, sample in enumerate(flight.samples[:samples]):
        estimator.update(sample)
        if k in behind:
            estimator.update_report(behind[k])
    assert estimator.snapshot.context.phase is Phase.AIDED
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
            assert estimator.update_report(report) is None
        if after is not None:
            after(k)
    return attitudes
