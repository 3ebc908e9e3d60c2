"""A flight worth watching, with known truth: what a copter's sensors feel from ground to ground.

The path is a closed function of time, and everything else follows from it: the rotors push along
body up, so the attitude is that of the thrust the path needs against gravity and drag; the rate is
the attitude's change; the specific force is acceleration less gravity. A round of ``ROUND_S``:
on the ground, a climb, figures of eight, a hover during which a magnet passes, more eights with a
stretch of silence, and the landing. At the very start somebody still sets the copter down: an
estimator that aligns by the first sample starts wrong.
"""

from typing import NamedTuple

import numpy as np

from drivers.samples.navigation import METRES_A_DEGREE
from estimator.geometry.rotations import conjugate, from_matrices, log, multiply, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, Floats, Vec3

ROUND_S = 100.0
SET_DOWN_S = 2.0  # after that nobody touches it
SHAKE_M, SHAKE_HZ = 0.04, 1.3  # level, by hand: 2.7 m/s^2 at first
ALOFT_S = (7.0, 99.0)  # off the ground
EIGHTS_S = ((12.0, 46.0), (56.0, 92.0))
TURNS_S = (12.0, 94.0)  # the nose looks around
MAGNET_S = (50.0, 52.0)  # in the hover
SILENCE_S = (76.0, 76.9)  # nothing is sent: behind a hill

# Zurich, where PX4's simulator starts, too; World Magnetic Model 2025 at 2026.0, gauss NED
LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 47.397742, 8.545594, 488.0
FIELD_NED_GAUSS: Vec3 = (0.2152, 0.0133, 0.4329)

EIGHT_M = (45.0, 16.0)  # half the length and half the width of the figure
EIGHT_S = 20.0  # once around it
HEIGHT_M = 20.0
DRAG_1_S = 0.15  # deceleration by the air, per speed
DERIVATIVE_STEP_S = 1e-2
RATE_STEP_S = 1e-3


class FlightTruth(NamedTuple):
    """The truth at N times."""

    q_ned_frd: Floats  # (N, 4)
    rate_rad_s: Floats  # (N, 3), FRD
    force_frd_m_s2: Floats  # (N, 3), specific force
    velocity_ned_m_s: Floats  # (N, 3)
    position_ned_m: Floats  # (N, 3), from the place of start


def flight_truth(time_s: Floats) -> FlightTruth:
    """The flight at times (N,) in s from its start."""
    q = _attitude(time_s)
    velocity, force = _derivatives(time_s)
    # acceleration north of a copter in somebody's hands, m/s^2
    fading = 1.0 - _step(time_s / SET_DOWN_S)
    swing = (2 * np.pi * SHAKE_HZ) ** 2 * SHAKE_M
    force[:, 0] += fading * swing * np.cos(2 * np.pi * SHAKE_HZ * time_s)
    force[:, 2] -= STANDARD_GRAVITY_M_S2
    h = RATE_STEP_S
    before, after = _attitude(time_s - h), _attitude(time_s + h)
    # Omega = log(q(t - h)* q(t + h)) / 2h
    return FlightTruth(
        q,
        log(multiply(conjugate(before), after)) / (2 * h),
        rotate_inverse(q, force),
        velocity,
        _position(time_s),
    )


def is_silent(time_us: int) -> bool:
    """Whether nothing is sent at this time of the flight."""
    begin, end = SILENCE_S
    return round(1e6 * begin) <= time_us % round(1e6 * ROUND_S) < round(1e6 * end)


def geodetic(position_ned_m: Vec3) -> Vec3:
    """Latitude and longitude (deg) and altitude (m) of a position near the start."""
    north, east, down = position_ned_m
    shrinking = np.cos(np.radians(LATITUDE_DEG))
    return (
        LATITUDE_DEG + north / METRES_A_DEGREE,
        float(LONGITUDE_DEG + east / METRES_A_DEGREE / shrinking),
        ALTITUDE_M - down,
    )


def _position(time_s: Floats) -> Floats:
    """Figures of eight, stretched out and drawn together again, above the place of start."""
    t = time_s % ROUND_S
    out = sum(_rise_and_fall(t, span, 7.0) for span in EIGHTS_S)
    phase = 2 * np.pi * t / EIGHT_S
    north = out * EIGHT_M[0] * np.sin(phase)
    east = out * EIGHT_M[1] * np.sin(2 * phase)
    down = -HEIGHT_M * _rise_and_fall(t, ALOFT_S, 10.0)
    return np.stack([north, east, down], axis=1)


def _rise_and_fall(t: Floats, span: tuple[float, float], ramp_s: float) -> Floats:
    """1 within the span, 0 outside it; the ramps are smooth."""
    return _step((t - span[0]) / ramp_s) * _step((span[1] - t) / ramp_s)


def _step(x: Floats) -> Floats:
    """0 below 0, 1 above 1, with four derivatives that are 0 at both ends."""
    x = np.clip(x, 0.0, 1.0)
    smooth: Floats = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
    return smooth


def _derivatives(time_s: Floats) -> tuple[Floats, Floats]:
    """Velocity and acceleration by five points, errors h^4/30 and h^4/90 of higher derivatives."""
    h = DERIVATIVE_STEP_S
    p = [_position(time_s + k * h) for k in (-2, -1, 0, 1, 2)]
    velocity: Floats = (p[0] - 8 * p[1] + 8 * p[3] - p[4]) / (12 * h)
    acceleration: Floats = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h**2)
    return velocity, acceleration


def _attitude(time_s: Floats) -> Floats:
    """Body down along gravity less acceleration and drag, the nose towards the yaw."""
    velocity, acceleration = _derivatives(time_s)
    down = -acceleration - DRAG_1_S * velocity
    down[:, 2] += STANDARD_GRAVITY_M_S2
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    # two rounds to the right in each round of the flight, unevenly
    share = _step((time_s % ROUND_S - TURNS_S[0]) / (TURNS_S[1] - TURNS_S[0]))
    yaw = 0.5 + 4 * np.pi * share + 2.0 * np.sin(2 * np.pi * share)
    nose = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    right = np.cross(down, nose)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    forward = np.cross(right, down)
    return from_matrices(np.stack([forward, right, down], axis=2))
