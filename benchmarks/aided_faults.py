"""Faults put into a flight, and what sigma says of them with and without measured vectors."""

from collections.abc import Callable
from math import radians
from typing import Any, NamedTuple

import msgspec
import numpy as np
from aided_recording import AidedRecording, record_aided

from drivers.events import Event, Imu, Velocity
from estimator.geometry.quaternion import add, exp
from estimator.types import ImuSample, Quaternion, Vec3, VelocitySample

Events = list[Event]
FAULT_S = 150.0
# Before the fault, and three times after it.
SPANS_S = ((-60.0, 0.0), (1.0, 5.0), (5.0, 20.0), (20.0, 40.0))


class Fault(NamedTuple):
    """From ``FAULT_S`` on: what becomes of samples and of velocities, given s since then."""

    name: str
    sample: Callable[[float, ImuSample], ImuSample] = lambda _, sample: sample
    velocity: Callable[[float, VelocitySample], VelocitySample] = lambda _, report: report
    turn: Quaternion | None = None  # that the gyroscope does not feel


def more_rate(by: Vec3) -> Callable[[float, ImuSample], ImuSample]:
    """A step of the gyroscope's bias."""
    return lambda _, s: s._replace(gyr_rad_s=add(s.gyr_rad_s, by))


def more_force(by: Vec3) -> Callable[[float, ImuSample], ImuSample]:
    """A step of the accelerometer's bias."""
    return lambda _, s: s._replace(acc_m_s2=add(s.acc_m_s2, by))


def magnet(by: Vec3) -> Callable[[float, ImuSample], ImuSample]:
    """A magnet that is attached in flight."""
    return lambda _, s: s._replace(mag_gauss=add(s.mag_gauss, by)) if s.has_mag else s


def wrong_velocity(
    north_m_s: Callable[[float], float],
) -> Callable[[float, VelocitySample], VelocitySample]:
    """Every source says so much more to the north."""
    return lambda t, r: r._replace(
        velocity_ned_m_s=add(r.velocity_ned_m_s, (north_m_s(t), 0.0, 0.0))
    )


FAULTS = (
    Fault("none"),
    Fault("turned unfelt, 20 deg about down", turn=exp((0.0, 0.0, radians(20.0)))),
    Fault("turned unfelt, 60 deg", turn=exp((0.6, 0.6, 0.6))),
    Fault("gyroscope, 0.02 rad/s a component", sample=more_rate((0.02, -0.02, 0.02))),
    Fault("accelerometer, 0.5 m/s^2 on two", sample=more_force((0.5, -0.5, 0.0))),
    Fault("magnet, 60 mGauss", sample=magnet((0.036, 0.038, -0.029))),
    Fault("magnet, 200 mGauss", sample=magnet((0.12, 0.128, -0.096))),
    Fault("velocity, 4 m/s from then on", velocity=wrong_velocity(lambda _: 4.0)),
    Fault("velocity, 8 m/s for 5 s", velocity=wrong_velocity(lambda t: 8.0 * (t < 5.0))),
    Fault("velocity, 0.3 m/s^2 for 20 s", velocity=wrong_velocity(lambda t: 0.3 * min(t, 20.0))),
)


def break_flight(events: Events, fault: Fault) -> AidedRecording:
    """The flight with the fault, replayed."""
    begin_us = next(e.sample.time_us for e in events if isinstance(e, Imu))
    broken = [_changed(event, fault, begin_us) for event in events]
    return record_aided(broken, turn_at_s=FAULT_S, turn=fault.turn)


def _changed(event: Event, fault: Fault, begin_us: int) -> Event:
    if not isinstance(event, Imu | Velocity):
        return event
    since_s = 1e-6 * (event.sample.time_us - begin_us) - FAULT_S
    if since_s < 0.0:
        return event
    if isinstance(event, Imu):
        return msgspec.structs.replace(event, sample=fault.sample(since_s, event.sample))
    return msgspec.structs.replace(event, sample=fault.velocity(since_s, event.sample))


def coverage(of: AidedRecording) -> list[dict[str, Any]]:
    """Of each span: RMS errors, shares of them under sigma by the covariance and as published."""
    result = []
    for first, last in SPANS_S:
        inside = of.known & (of.time_s >= FAULT_S + first) & (of.time_s < FAULT_S + last)
        span: dict[str, Any] = {"from_s": first, "to_s": last}
        for axis, error, column in (("inclination", 2, 0), ("heading", 1, 1)):
            errors = of.errors[inside, error]
            span[axis] = {
                "rms_deg": float(np.degrees(np.sqrt(np.mean(errors**2)))),
                "by_covariance": float(np.mean(errors <= of.columns["certain"][inside, column])),
                "published": float(np.mean(errors <= of.sigma[inside, column])),
            }
        span["error"] = float(np.median(of.columns["error"][inside]))
        result.append(span)
    return result
