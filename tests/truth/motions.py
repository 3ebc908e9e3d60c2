"""True motions in closed form on a fine grid, from which all readings are made."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from estimator.geometry.rotations import (
    conjugate,
    exp,
    from_matrices,
    log,
    multiply,
    rotate_inverse,
    running_product,
)
from estimator.types import STANDARD_GRAVITY_M_S2 as G
from estimator.types import Floats

FINE_HZ = 200
DURATION_S = 80.0
REST_S = 10.0
TIME_S = np.arange(round(DURATION_S * FINE_HZ)) / FINE_HZ
RATTLE = (0.5, 0.01)  # m/s^2 and rad/s, of most vehicles
# MAV_TYPE
HAND_HELD, PLANE, COPTER, ROVER, SUBMARINE, OCTOCOPTER = 0, 1, 2, 10, 12, 14


class Motion(NamedTuple):
    """The truth on ``TIME_S``, and how the sensors are shaken."""

    vehicle_type: int
    q_ned_frd: Floats  # (N, 4)
    rate_rad_s: Floats  # (N, 3), FRD
    force_m_s2: Floats  # (N, 3), specific force, FRD
    velocity_m_s: Floats  # (N, 3), NED
    acc_vibration_m_s2: float = 0.0  # standard deviation while it moves
    gyr_vibration_rad_s: float = 0.0


class Draw:
    """Where the sizes of a motion come from: as listed, or scattered about that by ``spread``."""

    def __init__(self, seed: int, spread: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self._spread = spread

    def size(self, nominal: float) -> float:
        """A size whose logarithm is scattered by ``spread``."""
        return float(nominal * np.exp(self._spread * self.rng.uniform(-1.0, 1.0)))

    def angle(self) -> float:
        """Any angle, rad."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def waves(self, sigma: float, periods_s: tuple[float, float]) -> Floats:
        """A sum of eight sines with periods in a range, of standard deviation ``sigma``: (N,)."""
        shortest, longest = periods_s
        periods = shortest * (longest / shortest) ** self.rng.random(8)
        phases = self.rng.uniform(-np.pi, np.pi, 8)
        waves = np.sin(2 * np.pi * TIME_S[:, None] / periods + phases)
        return np.asarray(0.5 * sigma * np.sum(waves, axis=1))


def still(draw: Draw) -> Motion:
    """A copter on uneven ground."""
    roll, pitch = draw.size(0.05), draw.size(0.03)
    level = np.ones_like(TIME_S)
    q = _from_euler(roll * level, pitch * level, draw.angle() * level)
    return _motion(COPTER, q, np.zeros((len(TIME_S), 3)))


def hover(draw: Draw) -> Motion:
    """An octocopter that holds its place in light wind and vibrates."""
    motion = _copter(draw, lean_rad=0.03, periods_s=(2.0, 10.0), yaw_rad_s=0.05)
    shaken = {"acc_vibration_m_s2": draw.size(4.0), "gyr_vibration_rad_s": draw.size(0.06)}
    return motion._replace(vehicle_type=OCTOCOPTER, **shaken)


def slalom(speed_m_s: float) -> Callable[[Draw], Motion]:
    """A car that drives to the left and right of its way, flat."""

    def drive(draw: Draw) -> Motion:
        speed, across, period_s = draw.size(speed_m_s), draw.size(4.0), draw.size(16.0)
        begin_s = REST_S + speed / 2.5
        speeds = speed * step((TIME_S - REST_S) / (speed / 2.5))
        wave = np.sin(2 * np.pi * (TIME_S - begin_s) / period_s)
        turning = across / speed * wave * step((TIME_S - begin_s) / 2.0)
        return _car(draw, speeds, turning)

    return drive


def circle(draw: Draw) -> Motion:
    """A car that drives round and round, flat."""
    speed, across = draw.size(8.0), draw.size(3.2)
    speeds = speed * step((TIME_S - REST_S) / 4.0)
    return _car(draw, speeds, across / speed * step((TIME_S - REST_S - 4.0) / 2.0))


def accelerate_and_brake(draw: Draw) -> Motion:
    """A car that drives straight on, accelerates, brakes and stands, again and again."""
    push, push_s = draw.size(3.0), min(draw.size(8.0), 14.0)
    round_s = 2.0 * push_s + 8.0
    t = np.where(TIME_S < REST_S, 0.0, (TIME_S - REST_S) % round_s)
    acceleration = push * (_pulse(t, 0.0, push_s) - _pulse(t, push_s + 4.0, 2.0 * push_s + 4.0))
    return _car(draw, _integral(acceleration), draw.waves(0.01, (5.0, 20.0)) * (t > 0.0))


def started_moving(draw: Draw) -> Motion:
    """A car that is in the middle of its drive when the first sample comes."""
    speed = draw.size(12.0)
    turning = draw.waves(draw.size(0.15), (8.0, 25.0))
    speeds = speed + draw.waves(draw.size(3.0), (15.0, 40.0))
    return _car(draw, np.maximum(speeds, 1.0), turning)


def started_banking(draw: Draw) -> Motion:
    """A plane that is in the middle of its turns when the first sample comes."""
    speed, bank, period_s = draw.size(20.0), min(draw.size(0.7), 1.1), draw.size(30.0)
    roll = bank * np.tanh(3.0 * np.sin(2 * np.pi * TIME_S / period_s + draw.angle()))
    speeds = speed * (1.0 + draw.waves(0.08, (6.0, 15.0)))
    yaw = draw.angle() + _integral(G * np.tan(roll) / speeds)
    q = _from_euler(roll, np.full_like(roll, 0.05), yaw)
    return _motion(PLANE, q, _along(speeds, yaw, draw.waves(0.04, (3.0, 9.0))), *RATTLE)


def coasting_turn(draw: Draw) -> Motion:
    """A submarine without thrust: its turn fades from 1.5 to 0.3 deg/s."""
    fading = np.exp(-np.maximum(TIME_S - REST_S - 5.0, 0.0) / draw.size(40.0))
    under_way = step((TIME_S - REST_S) / 5.0)
    turning = np.radians(draw.size(1.5)) * fading * under_way
    speeds = draw.size(1.5) * fading * under_way
    roll, pitch = (under_way * draw.waves(0.003, (10.0, 30.0)) for _ in range(2))
    yaw = draw.angle() + _integral(turning)
    return _motion(SUBMARINE, _from_euler(roll, pitch, yaw), _along(speeds, yaw))


def climb_and_turn(draw: Draw) -> Motion:
    """A plane that takes off, climbs, and banks one way and the other."""
    speed, bank, period_s = draw.size(20.0), min(draw.size(0.7), 1.1), draw.size(30.0)
    run_s = speed / 3.0
    speeds = speed * step((TIME_S - REST_S) / run_s)
    aloft = step((TIME_S - REST_S - run_s) / 3.0)
    wave = np.tanh(3.0 * np.sin(2 * np.pi * (TIME_S - REST_S - run_s - 3.0) / period_s))
    roll = bank * wave * aloft
    climb = draw.size(0.12) * aloft * (1.0 + 0.3 * np.sin(2 * np.pi * TIME_S / 17.0))
    # a coordinated turn: g tan(roll) across the way
    yaw = draw.angle() + _integral(G * np.tan(roll) * aloft / np.maximum(speeds, 5.0))
    attack = 0.05 * aloft
    q = _from_euler(roll, climb + attack, yaw)
    return _motion(PLANE, q, _along(speeds, yaw, climb), *RATTLE)


def aerobatics(draw: Draw) -> Motion:
    """A plane that loops and rolls, with straight stretches between."""
    speed, order = draw.size(25.0), draw.rng.permutation(6)
    rate = np.zeros((len(TIME_S), 3))
    t_s = REST_S + speed / 3.0 + 3.0
    while t_s < DURATION_S:
        for kind in order:
            span_s = draw.size((9.0, 4.0)[kind % 2])
            turn = 2 * np.pi * (-1.0 if kind % 4 == 1 else 1.0)
            # a smooth pulse whose integral is one whole turn
            rate[:, 1 - kind % 2] += turn * np.gradient(step((TIME_S - t_s) / span_s), TIME_S)
            t_s += span_s + draw.size(3.0)
    q = integrated(rate, draw.angle())
    nose = rotate_inverse(conjugate(q), (1.0, 0.0, 0.0))
    speeds = speed * step((TIME_S - REST_S) / (speed / 3.0)) * (1.0 + 0.25 * nose[:, 2])
    return _motion(PLANE, q, speeds[:, None] * nose, *RATTLE)


def in_hand(draw: Draw) -> Motion:
    """An IMU that somebody takes up, turns about and moves to and fro, with pauses."""
    busy = step((TIME_S - REST_S) / 1.0) * step(4.0 * np.sin(2 * np.pi * TIME_S / 25.0) + 3.0)
    roll, pitch = (busy * draw.waves(draw.size(0.4), (1.5, 8.0)) for _ in range(2))
    yaw = draw.angle() + busy * draw.waves(draw.size(0.8), (2.0, 8.0))
    places = [busy * draw.waves(draw.size(0.04), (0.6, 3.0)) for _ in range(3)]
    velocity = np.gradient(np.stack(places, axis=1), 1.0 / FINE_HZ, axis=0)
    return _motion(HAND_HELD, _from_euler(roll, pitch, yaw), velocity)


def _copter(
    draw: Draw, lean_rad: float, periods_s: tuple[float, float], yaw_rad_s: float
) -> Motion:
    """A copter pushed about at random; its thrust is along body up, drag aside."""
    aloft = step((TIME_S - REST_S) / 4.0)
    sigma = G * np.tan(draw.size(lean_rad))
    pushes = [aloft * draw.waves(sigma, periods_s) for _ in range(2)]
    pushes.append(aloft * draw.waves(0.3, (3.0, 10.0)))
    push = np.stack(pushes, axis=1)
    velocity = np.cumsum(push - np.mean(push, axis=0), axis=0) / FINE_HZ
    velocity *= aloft[:, None]
    acceleration = np.gradient(velocity, 1.0 / FINE_HZ, axis=0)
    yaw = draw.angle() + _integral(aloft * draw.waves(yaw_rad_s, (5.0, 20.0)))
    down = -acceleration - 0.1 * velocity + (0.0, 0.0, G)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    nose = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    right = np.cross(down, nose)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    q = from_matrices(np.stack([np.cross(right, down), right, down], axis=2))
    return _motion(COPTER, q, velocity, *RATTLE)


def _car(draw: Draw, speeds: Floats, turning: Floats) -> Motion:
    """A car on a flat road, with its rattle; speeds in m/s, turning in rad/s, both (N,)."""
    yaw = draw.angle() + _integral(turning)
    rough = np.minimum(speeds, 1.0)
    roll, pitch = (rough * draw.waves(0.01, (0.5, 5.0)) for _ in range(2))
    return _motion(ROVER, _from_euler(roll, pitch, yaw), _along(speeds, yaw), *RATTLE)


def _motion(vehicle_type: int, q: Floats, velocity: Floats, *vibration: float) -> Motion:
    """Rate and specific force that belong to attitude and velocity."""
    turn = log(multiply(conjugate(q[:-2]), q[2:])) * (0.5 * FINE_HZ)
    rate = np.vstack([turn[:1], turn, turn[-1:]])
    force = np.gradient(velocity, 1.0 / FINE_HZ, axis=0) - (0.0, 0.0, G)
    return Motion(vehicle_type, q, rate, rotate_inverse(q, force), velocity, *vibration)


def _along(speeds: Floats, yaw: Floats, climb: Floats | None = None) -> Floats:
    up = np.zeros_like(yaw) if climb is None else climb
    level = np.cos(up)
    nose = np.stack([np.cos(yaw) * level, np.sin(yaw) * level, -np.sin(up)], axis=1)
    return np.asarray(speeds[:, None] * nose)


def _from_euler(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    zero = np.zeros_like(yaw)
    phi = ((zero, zero, yaw), (zero, pitch, zero), (roll, zero, zero))
    by_yaw, by_pitch, by_roll = (exp(np.stack(each, axis=1)) for each in phi)
    return multiply(multiply(by_yaw, by_pitch), by_roll)


def integrated(rate: Floats, heading_rad: float) -> Floats:
    """Attitudes (N, 4) of a body rate (N, 3), level at first."""
    turns = np.vstack([[[0.0, 0.0, heading_rad]], 0.5 * (rate[1:] + rate[:-1]) / FINE_HZ])
    return running_product(exp(turns))


def _integral(values: Floats) -> Floats:
    return np.cumsum(values) / FINE_HZ


def step(x: Floats) -> Floats:
    """0 below 0, 1 above 1, smooth between."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def _pulse(t: Floats, begin: float, end: float) -> Floats:
    return step((t - begin) / 0.5) * step((end + 0.5 - t) / 0.5)


MOTIONS: dict[str, Callable[[Draw], Motion]] = {
    "still": still,
    "hover": hover,
    "gentle tilts": lambda draw: _copter(draw, 0.13, (4.0, 15.0), 0.2),  # by up to 15 deg
    "vigorous tilts": lambda draw: _copter(draw, 0.35, (3.0, 10.0), 0.5),  # by up to 40 deg
    "slalom 12": slalom(12.0),
    "slalom 20": slalom(20.0),
    "slalom 30": slalom(30.0),
    "circle": circle,
    "accelerate and brake": accelerate_and_brake,
    "started moving": started_moving,
    "started banking": started_banking,
    "coasting turn": coasting_turn,
    "climb and turn": climb_and_turn,
    "aerobatics": aerobatics,
    "hand": in_hand,
}
