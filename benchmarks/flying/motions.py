"""True motions of simulated vehicles: planes, copters, rovers and cars.

Each begins with ``REST_S`` of rest and goes on at random. Nothing is shared with the
estimator but quaternion algebra.
"""

from collections.abc import Callable, Generator
from functools import partial
from math import asin, atan2, cos, pi, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np
from common.recordings import Array

from estimator.geometry.quaternion import add, exp, multiply, normalize, rotate, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

FINE_HZ = 400
DT = 1.0 / FINE_HZ
REST_S = 30.0
LEAST_AIRSPEED, MOST_TURN_RAD = 14.0, 1.2
PLANE_LEGS = ("bank 60", "loop", "straight", "bank -60", "roll", "bank 30", "bank -45", "climb")


class Motion(NamedTuple):
    """Truth at ``FINE_HZ``: attitude (N, 4), body rate (N, 3), velocity in NED (N, 3).

    ``throttle`` (N,) is 1 in a hover and in a plane's cruise, about.
    """

    attitude: Array
    rate: Array
    velocity: Array
    throttle: Array


class Moment(NamedTuple):
    """The motion at one step."""

    rate: Vec3
    velocity: Vec3
    throttle: float


STILL = Moment(ZERO_VEC3, ZERO_VEC3, 0.0)
# What a vehicle does at each attitude that it is sent, one a step.
Vehicle = Generator[Moment, Quaternion, None]


def integrate(vehicle: Callable[[np.random.Generator], Vehicle], seed: int, s: float) -> Motion:
    """The motion of a vehicle over ``s`` seconds, from a heading at random on."""
    rng = np.random.default_rng(seed)
    q, n = exp((0.0, 0.0, float(rng.uniform(-pi, pi)))), int(s * FINE_HZ)
    moves = vehicle(rng)
    next(moves)
    out = Motion(np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n))
    for k in range(n):
        now = moves.send(q)
        out.attitude[k], out.rate[k] = q, now.rate
        out.velocity[k], out.throttle[k] = now.velocity, now.throttle
        turn = (now.rate[0] * DT, now.rate[1] * DT, now.rate[2] * DT)
        q = normalize(multiply(q, exp(turn)))
    return out


def roll_and_pitch(q: Quaternion) -> tuple[float, float]:
    down = rotate_inverse(q, (0.0, 0.0, 1.0))
    return atan2(down[1], down[2]), -asin(max(-1.0, min(1.0, down[0])))


def clip(value: float, most: float) -> float:
    return max(-most, min(most, value))


class Gusts:
    """First-order noise of three components."""

    def __init__(self, rng: np.random.Generator, sigmas: Vec3, tau_s: float) -> None:
        self._rng, self._keep = rng, 1.0 - DT / tau_s
        self._drive, self._now = np.array(sigmas) * sqrt(2.0 * DT / tau_s), np.zeros(3)

    def next(self) -> Vec3:
        """The three components at the next step."""
        self._now = self._keep * self._now + self._drive * self._rng.standard_normal(3)
        return tuple(self._now.tolist())


def plane(rng: np.random.Generator) -> Vehicle:
    """Take-off run, then legs at random; speed falls in climbs, gusts shake it."""
    shaken = Gusts(rng, (0.25, 0.13, 0.08), 0.7)
    wind = Gusts(rng, (0.5,) * 3, 0.5)
    smooth = np.zeros(3)
    leg, left, speed, rate, attack = "rest", REST_S, 0.0, (0.0, 0.0, 0.0), 0.0
    now = STILL
    while True:
        q = yield now
        roll, pitch = roll_and_pitch(q)
        left -= DT
        if left <= 0.0:
            leg = "run" if leg == "rest" else str(rng.choice(PLANE_LEGS))
            left = {"run": 12.0, "loop": 2.0 * pi, "roll": 4.0}.get(leg, rng.uniform(6.0, 20.0))
        if leg == "run":
            speed = min(speed + 3.0 * DT, 22.0)
        elif leg != "rest":
            pull = -0.35 * STANDARD_GRAVITY_M_S2 * sin(pitch) + 0.3 * (24.0 - speed)
            speed = max(speed + min(pull, 3.0) * DT, 12.0)
        turning = ZERO_VEC3
        asked = _winged_rate(leg, roll, pitch, speed)
        rate = tuple(r + (a - r) * DT / 0.15 for r, a in zip(rate, asked, strict=True))
        if leg not in ("rest", "run"):
            turning = add(rate, shaken.next())
            smooth += (np.array(wind.next()) - smooth) * DT / 0.15
        elif leg == "run":
            turning = rate
        attack += (0.04 + 0.03 * abs(turning[1]) - attack) * DT / 0.3
        angle = attack * min(1.0, max(0.0, (speed - 12.0) / 4.0))
        ahead = (speed * cos(angle), 0.0, speed * sin(angle))
        velocity = add(rotate(q, ahead), tuple(smooth.tolist()))
        throttle = 0.0 if leg == "rest" else 1.4 if leg in ("run", "climb") else 0.8
        now = Moment(turning, velocity, throttle)


def _winged_rate(leg: str, roll: float, pitch: float, speed: float) -> Vec3:
    """The body rate of the leg: a coordinated turn towards its bank and pitch."""
    if leg == "loop":
        return (0.0, 1.0, 0.0)
    if leg == "roll":
        return (pi / 2.0, 0.0, 0.0)
    if leg == "rest":
        return ZERO_VEC3
    bank = radians(float(leg.split()[1])) if leg.startswith("bank") else 0.0
    climb = radians({"climb": 12.0, "run": 4.0}.get(leg, 0.0)) if speed > 15.0 else 0.0
    up = clip(1.5 * (climb - pitch), 0.6)
    steep = tan(clip(roll, MOST_TURN_RAD))
    yaw = STANDARD_GRAVITY_M_S2 * steep / speed if speed > LEAST_AIRSPEED else 0.0
    return (
        clip(2.0 * (bank - roll), 1.5) - yaw * sin(pitch),
        up * cos(roll) + yaw * sin(roll) * cos(pitch),
        -up * sin(roll) + yaw * cos(roll) * cos(pitch),
    )


def copter(
    rng: np.random.Generator, most_tilt: float = 0.8, shake: float = 0.18, flips: float = 0.03
) -> Vehicle:
    """Tilts of up to 45 degrees and turns at random, braked by drag, and now and then a flip."""
    velocity, rate, wanted = np.zeros(3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    left, flying, flip_s = REST_S, False, 0.0
    down = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    rough = shake * sqrt(DT)
    now = STILL
    while True:
        q = yield now
        roll, pitch = roll_and_pitch(q)
        left -= DT
        if left <= 0.0:
            flying, left = True, float(rng.uniform(1.5, 8.0))
            tilts = rng.uniform(-most_tilt, most_tilt, 2) * (rng.random() > 0.25)
            yaw = float(rng.uniform(-1.5, 1.5)) * bool(rng.random() < 0.5) * most_tilt / 0.8
            wanted = (*tilts.tolist(), yaw)
            flip_s = 2.0 * pi / 7.0 if rng.random() < flips else 0.0
        if not flying:
            continue
        drift = rotate_inverse(q, tuple(velocity.tolist()))
        flip_s -= DT
        asked = (
            clip(5.0 * (wanted[0] - 0.02 * drift[1] - roll), 4.0),
            clip(5.0 * (wanted[1] + 0.02 * drift[0] - pitch), 4.0),
            wanted[2],
        )
        if flip_s > 0.0:
            asked = (7.0, 0.0, 0.0)
        n = rng.standard_normal(3).tolist()
        follow = DT / 0.08
        rate = tuple(
            r + (a - r) * follow + rough * e for r, a, e in zip(rate, asked, n, strict=True)
        )
        hover = STANDARD_GRAVITY_M_S2 / max(0.4, cos(roll) * cos(pitch))
        if cos(roll) < 0.0:
            hover = 0.2 * STANDARD_GRAVITY_M_S2
        up = hover + 0.6 * float(velocity[2])
        force = np.array(rotate(q, (0.0, 0.0, -up))) - 0.25 * velocity
        velocity = velocity + (force + down) * DT
        now = Moment(rate, tuple(velocity.tolist()), up / STANDARD_GRAVITY_M_S2)


def rover(rng: np.random.Generator) -> Vehicle:
    """Drives and reverses at up to 5 m/s over slopes, turning as sharply as its tyres hold."""
    bumps = Gusts(rng, (0.12, 0.12, 0.0), 0.15)
    slope = Gusts(rng, (0.06, 0.06, 0.0), 6.0)
    speed, wanted, turn, wanted_turn, left, driving = 0.0, 0.0, 0.0, 0.0, REST_S, False
    now = STILL
    while True:
        q = yield now
        roll, pitch = roll_and_pitch(q)
        left -= DT
        if left <= 0.0:
            driving, left = True, float(rng.uniform(2.0, 9.0))
            wanted = float(rng.choice((5.0, 3.0, 2.0, 1.0, 0.0, -1.5)))
            wanted_turn = float(rng.choice((0.0, 0.0, 0.3, -0.3, 0.8, -0.8)))
        if not driving:
            continue
        before = speed
        speed += clip(wanted - speed, 1.0) * 1.5 * DT
        grip = 4.0 / max(abs(speed), 0.5)
        turn += (clip(wanted_turn, grip) - turn) * DT / 0.3
        moving = min(1.0, abs(speed))
        shaken, sloped = bumps.next(), slope.next()
        yaw = turn * moving
        rate = (
            moving * shaken[0] + clip(2.0 * (sloped[0] - roll), 0.5) * moving,
            moving * shaken[1] + clip(2.0 * (sloped[1] - pitch), 0.5) * moving,
            yaw,
        )
        load = 0.5 * moving + abs(speed - before) / DT / 3.0
        now = Moment(rate, rotate(q, (speed, 0.0, 0.0)), load)


def car(rng: np.random.Generator) -> Vehicle:
    """Streets, corners, roundabouts, stops and parking in reverse, with an IMU in the cabin.

    It is mounted a degree or two askew and ahead of the rear axle, and tyres slip in turns.
    """
    yaw_off, pitch_off = (float(a) for a in radians(1.5) * rng.standard_normal(2))
    askew = exp((0.0, pitch_off, yaw_off))
    bumps = Gusts(rng, (0.04, 0.04, 0.01), 0.15)
    slope = Gusts(rng, (0.02, 0.03, 0.0), 8.0)
    speed, turn, wanted, curvature, left = 0.0, 0.0, 0.0, 0.0, REST_S
    ahead: list[tuple[float, float, float]] = []  # of a leg: speed, curvature, how long
    now = STILL
    while True:
        q = yield now
        roll, pitch = roll_and_pitch(q)
        left -= DT
        if left <= 0.0:
            if not ahead:
                ahead.extend(_street(rng))
            wanted, curvature, left = ahead.pop(0)
        push = clip(wanted - speed, 1.0) * 2.5
        speed += push * DT
        turn += (clip(curvature * speed, 0.6) - turn) * DT / 0.5
        across = speed * turn
        moving = min(1.0, abs(speed) / 3.0)
        shaken, sloped = bumps.next(), slope.next()
        rate = (
            moving * (shaken[0] + clip(2.0 * (sloped[0] + 0.006 * across - roll), 0.3)),
            moving * (shaken[1] + clip(2.0 * (sloped[1] + 0.004 * push - pitch), 0.3)),
            turn + moving * shaken[2],
        )
        sideways = 1.2 * turn - 0.004 * across * abs(speed)
        along = rotate(askew, (speed, sideways, 0.0))
        now = Moment(rate, rotate(q, along), 0.5 * moving + 0.2 * abs(push))


def _street(rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Speed (m/s), curvature (1/m) and duration (s) of what comes next."""
    side = float(rng.choice((-1.0, 1.0)))
    kind = str(rng.choice(("street", "street", "corner", "roundabout", "light", "park")))
    fast = float(rng.uniform(8.0, 16.0))
    if kind == "street":
        return [(fast, side * float(rng.uniform(0.0, 0.006)), float(rng.uniform(6.0, 16.0)))]
    if kind == "corner":
        return [(5.0, 0.0, 3.0), (5.0, side * 0.1, pi), (fast, 0.0, 5.0)]
    if kind == "roundabout":
        length = float(rng.uniform(2.0, 7.0))
        return [(6.0, 0.0, 3.0), (6.0, -0.06, 1.0), (6.0, 0.08, length), (6.0, -0.06, 1.0)]
    if kind == "light":
        return [(0.0, 0.0, float(rng.uniform(5.0, 15.0)))]
    return [(0.0, 0.0, 8.0), (-1.5, side * 0.2, 5.0), (0.0, 0.0, 2.0), (3.0, -side * 0.1, 4.0)]


MOTIONS: dict[str, Callable[[np.random.Generator], Vehicle]] = {
    "plane": plane,
    "copter": copter,
    # a survey or a delivery: tilts of up to 20 degrees, slow turns
    "calm copter": partial(copter, most_tilt=0.35, shake=0.05, flips=0.0),
    "rover": rover,
    "car": car,
}
