"""The simulated vehicle: the paper's signals, or a flight's, with known truth, seeded.

Source of the paper's signals: section "Attitude Measurements and Initialization" of "Nonlinear
Attitude Filter on SO(3): Fast Adaptation and Robustness"::

    Omega_m = Omega + b + n                   n    ~ N(0, 0.2)   (standard deviation)
    v_i^B   = R^T v_i^I + b_i^B + n_i^B       n_i  ~ N(0, 0.05)
    dR/dt   = R [Omega]x,   R(0) = I

as an IMU reads them: acc = -g v_2^B and mag = 0.5 gauss v_1^B, neither normalised. The flight
(:mod:`drivers.simulation.flight`) has the errors of a small MEMS unit instead, and knows where it
is and how fast; "bench" is that unit turned by hand. With a seed of their own the sensors have
larger constant errors (:func:`imu_errors`), too. A block (:func:`simulate`) and a stream
(:class:`SimulatedVehicle`) give the same numbers bit for bit: the truth comes in chunks that start
at fixed samples, and each sample takes nine normal numbers in one order.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice
from math import ceil, floor, inf, isfinite
from typing import Generic, Literal, NamedTuple, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from drivers.simulation import flight
from estimator.errors import InputError
from estimator.geometry.rotations import exp, rotate_inverse, running_product
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, Floats, Quaternion, Vec3

Motion = Literal["paper", "rest", "turn", "flight", "bench"]
MOTIONS: tuple[str, ...] = get_args(Motion)
REAL = ("flight", "bench")  # with the errors of a real unit, in a real field
# The shipped profile that fits the signals of each
PROFILES = {motion: "imu" if motion in REAL else "paper" for motion in MOTIONS}

# The paper's inertial vectors (NED, unit length)
MAGNETIC_NED: Vec3 = (1 / 3**0.5, -1 / 3**0.5, 1 / 3**0.5)
GRAVITY_NED: Vec3 = (0.0, 0.0, 1.0)

GYRO_NOISE_RAD_S = 0.2  # the paper's
VECTOR_NOISE = 0.05  # the paper's, of a unit vector
FLIGHT_VELOCITY_NOISE_M_S = 0.05  # of the velocity that a vehicle that flies shows

FIELD_GAUSS = 0.5  # a typical strength of the Earth's field
TURN_RATE_RAD_S = 0.5  # "turn": level, to the right, one round in 12.6 s

# The magnet passes on the vehicle's right: a field along body y that rises and falls smoothly
# between the two times, in the middle as strong as the Earth's
MAGNET_PEAK_GAUSS = 0.5

# "bench": turned about all axes for a while, then laid down for a moment, again and again
BENCH_ROUND_S, BENCH_REST_S = 12.0, 3.0
BENCH_RATE_RAD_S: Vec3 = (1.9, 1.6, 1.4)

# Constant errors by seed (sigma): of scales and crossed axes, biases (rad/s, m/s^2), iron (gauss)
ERROR_SHARES = (0.005, 0.01, 0.02)  # of gyroscope, accelerometer and compass
ERROR_BIASES = (0.007, 0.15, 0.05)

CHUNK_SAMPLES = 128  # a stream computes this much ahead; 1.3 s at 100 Hz
# Fourth-order steps of 10 ms keep the truth within 1e-9 rad over the paper's 15 s
LONGEST_STEP_S = 0.01


Time = TypeVar("Time")
Vector = TypeVar("Vector")
Turn = TypeVar("Turn")


class Signals(NamedTuple, Generic[Time, Vector, Turn]):
    """The simulated vehicle at an instant, or at N of them; measured values are in FRD.

    ``time_us`` counts from the vehicle's start. ``q_ned_frd`` and all behind it are the truth.
    """

    time_us: Time
    gyr_rad_s: Vector
    acc_m_s2: Vector
    mag_gauss: Vector
    q_ned_frd: Turn
    true_rate_rad_s: Vector
    true_force_m_s2: Vector  # specific force, FRD
    velocity_ned_m_s: Vector  # zero of a motion that stays where it is
    position_ned_m: Vector  # from the place of start


Sample = Signals[int, Vec3, Quaternion]
Recording = Signals[npt.NDArray[np.int64], Floats, Floats]  # read-only: (N,), (N, 3), (N, 4)


def imu_errors(seed: int) -> list[tuple[Floats, Floats]]:
    """Constant errors of gyroscope (rad/s), accelerometer (m/s^2) and compass (gauss).

    Of each the matrix 1 + D (3, 3) and the bias b (3,): a sensor reads (1 + D) v + b.

    Raises:
        InputError: the seed is negative.
    """
    rng = _generator(seed)
    return [
        (np.eye(3) + rng.normal(0.0, share, (3, 3)), rng.normal(0.0, bias, 3))
        for share, bias in zip(ERROR_SHARES, ERROR_BIASES, strict=True)
    ]


# What one of v_1 and of v_2 is; in this order, behind the rate, are biases and noises (9,)
UNITS = np.repeat([1.0, FIELD_GAUSS, -STANDARD_GRAVITY_M_S2], 3)
PAPER_BIAS = UNITS * np.array([-0.1, 0.1, 0.05, 0.1, -0.1, 0.1, 0.0, 0.0, 0.1])
PAPER_NOISE = UNITS * np.repeat([GYRO_NOISE_RAD_S, VECTOR_NOISE, VECTOR_NOISE], 3)
# A small MEMS unit after the calibration that autopilots do: rad/s, gauss and m/s^2
REAL_BIAS = np.array([0.003, -0.004, 0.002, 0.004, -0.003, 0.005, 0.03, -0.025, 0.05])
REAL_NOISE = np.sign(UNITS) * np.repeat([0.003, 0.003, 0.1], 3)


def simulate(
    seed: int,
    samples: int,
    rate_hz: float = 100.0,
    motion: Motion = "paper",
    noise: float = 1.0,
    bias: float = 1.0,
    magnet: tuple[float, float] | None = None,
) -> Recording:
    """The first ``samples`` samples, at t = k / ``rate_hz``.

    ``noise`` and ``bias`` scale the paper's; ``magnet`` is the time (s) when a
    disturbing field begins and ends, see ``MAGNET_PEAK_GAUSS``.

    Raises:
        InputError: a value is out of its range, or the motion is unknown.
    """
    if samples < 1:
        raise InputError(f"the simulated vehicle needs at least 1 sample, not {samples}")
    vehicle = SimulatedVehicle(seed, rate_hz, motion, noise, bias, magnet)
    blocks = islice(vehicle.blocks(0, IDENTITY, rate_hz), ceil(samples / CHUNK_SAMPLES))
    columns = (np.concatenate(column)[:samples] for column in zip(*blocks, strict=True))
    return _read_only(Recording._make(columns))


class SimulatedVehicle:
    """An endless stream of the samples that :func:`simulate` gives as a block.

    A ``calm`` flight has no magnet and no silence, unless asked for.

    Raises:
        InputError: a value is out of its range, or the motion is unknown.
    """

    def __init__(
        self,
        seed: int,
        rate_hz: float = 100.0,
        motion: Motion = "paper",
        noise: float = 1.0,
        bias: float = 1.0,
        magnet: tuple[float, float] | None = None,
        *,
        calm: bool = False,
        errors_seed: int | None = None,
    ) -> None:
        if not (isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"the simulated vehicle's rate must be positive, not {rate_hz} Hz")
        if motion not in MOTIONS:
            raise InputError(f"unknown motion {motion!r}: choose {', '.join(MOTIONS)}")
        for name, value in (("noise", noise), ("bias", bias)):
            if not (isfinite(value) and value >= 0):
                raise InputError(f"the scale of the {name} must be 0 or more, not {value}")
        if magnet is not None and not (isfinite(sum(magnet)) and 0 <= magnet[0] < magnet[1]):
            raise InputError(f"the magnet must pass from T0 to a later T1 (s), not {magnet}")
        self.motion = motion
        self._bias = bias * (REAL_BIAS if motion in REAL else PAPER_BIAS)
        self._noise = noise * (REAL_NOISE if motion in REAL else PAPER_NOISE)
        self._errors = None if errors_seed is None else imu_errors(errors_seed)
        self._falls_silent = motion == "flight" and not calm
        self._magnet, self._round_s = magnet, inf  # once in each round
        if magnet is None and self._falls_silent:
            self._magnet, self._round_s = flight.MAGNET_S, flight.ROUND_S
        self._generator = _generator(seed)
        self._last: Sample | None = None
        self._samples = self._from(0, IDENTITY, rate_hz)

    def __iter__(self) -> Iterator[Sample]:
        return self

    def __next__(self) -> Sample:
        self._last = next(self._samples)
        return self._last

    @property
    def knows_place(self) -> bool:
        """Whether it knows where it is and how fast: the paper's vehicle turns on the spot."""
        return self.motion == "flight"

    def is_silent(self, time_us: int) -> bool:
        """Whether nothing of this time reaches anybody."""
        return self._falls_silent and flight.is_silent(time_us)

    def change_rate(self, rate_hz: float) -> None:
        """Go on with the same motion at t = k / ``rate_hz`` after the last sample."""
        first, start = 0, IDENTITY
        if self._last is not None:
            last_s = self._last.time_us * 1e-6
            first = floor(last_s * rate_hz + 1e-6) + 1
            if self.motion != "flight":
                times = np.array([last_s, first / rate_hz])
                start = tuple(_integrate(self.motion, times, self._last.q_ned_frd)[-1])
        self._samples = self._from(first, start, rate_hz)

    def _from(self, first: int, start: Quaternion, rate_hz: float) -> Iterator[Sample]:
        for block in self.blocks(first, start, rate_hz):
            columns = (map(tuple, each.tolist()) for each in block[1:])
            yield from map(Sample._make, zip(block.time_us.tolist(), *columns, strict=True))

    def blocks(self, first: int, start: Quaternion, rate_hz: float) -> Iterator[Recording]:
        """Samples number ``first``, ``first`` + 1, ..., the first at attitude ``start``."""
        while True:
            truth, start = _true_chunk(self.motion, rate_hz, first, start)
            first += CHUNK_SAMPLES
            # Omega_m = Omega + b + n and v_i^B = R^T v_i^I + b_i^B + n_i^B
            exact = np.hstack([truth.gyr_rad_s, truth.mag_gauss, truth.acc_m_s2])
            noise = self._noise * self._generator.standard_normal(exact.shape)
            gyr, mag, acc = np.split(exact + self._bias + noise, 3, axis=1)
            if self._magnet is not None:
                begin, end = self._magnet
                since_s = truth.time_us * 1e-6 % self._round_s - begin
                phase = np.clip(since_s / (end - begin), 0.0, 1.0)
                # (4 x (1 - x))^2 is sin^2(pi x) to within 0.07, and has the same bits in any block
                mag[:, 1] += MAGNET_PEAK_GAUSS * (4.0 * phase * (1.0 - phase)) ** 2
            if self._errors is not None:
                readings = zip(self._errors, (gyr, acc, mag), strict=True)
                gyr, acc, mag = (v @ matrix.T + bias for (matrix, bias), v in readings)
            yield _read_only(truth._replace(gyr_rad_s=gyr, acc_m_s2=acc, mag_gauss=mag))


def true_rate(motion: Motion, time_s: Floats) -> Floats:
    """Omega (rad/s, FRD) at times of shape (N,), as (N, 3)."""
    rate = np.zeros((len(time_s), 3))
    if motion == "paper":
        rate[:, 0] = np.sin(0.4 * time_s)
        rate[:, 1] = np.sin(0.7 * time_s + np.pi / 4)
        rate[:, 2] = 0.4 * np.sin(0.3 * time_s + np.pi / 2)
    elif motion == "turn":
        rate[:, 2] = TURN_RATE_RAD_S
    elif motion == "bench":
        phase = (time_s % BENCH_ROUND_S) / (BENCH_ROUND_S - BENCH_REST_S)
        swell = np.sin(np.pi * np.clip(phase, 0.0, 1.0)) ** 2
        ways = np.column_stack(
            [np.sin(0.37 * time_s), np.sin(0.53 * time_s + 1.0), np.cos(0.29 * time_s)]
        )
        rate = swell[:, None] * ways * BENCH_RATE_RAD_S
    return rate


def _generator(seed: int) -> np.random.Generator:
    if seed < 0:
        raise InputError(f"a seed must be 0 or more, not {seed}")
    return np.random.default_rng(seed)


@lru_cache(maxsize=64)  # vehicles that fly side by side share the truth, and seeds of one motion
def _true_chunk(
    motion: Motion, rate_hz: float, first: int, start: Quaternion
) -> tuple[Recording, Quaternion]:
    """Perfect readings from sample ``first`` on, which is at ``start``, and the attitude after."""
    time_s = (first + np.arange(CHUNK_SAMPLES + 1)) / rate_hz
    after = IDENTITY
    if motion == "flight":
        q, rate, force, velocity, position = flight.flight_truth(time_s[:-1])
    else:
        q = _integrate(motion, time_s, start)
        after = tuple((q[-1] / np.sqrt(np.sum(q[-1] ** 2))).tolist())
        q, rate = q[:-1], true_rate(motion, time_s[:-1])
        force = -STANDARD_GRAVITY_M_S2 * rotate_inverse(q, GRAVITY_NED)
        velocity = position = np.zeros_like(rate)
    paper_ned = FIELD_GAUSS * np.array(MAGNETIC_NED)
    field = rotate_inverse(q, flight.FIELD_NED_GAUSS if motion in REAL else paper_ned)
    time_us = np.rint(time_s[:-1] * 1e6).astype(np.int64)
    true = Recording(time_us, rate, force, field, q, rate, force, velocity, position)
    return _read_only(true), after


def _read_only(recording: Recording) -> Recording:
    for array in recording:
        array.setflags(write=False)
    return recording


def _integrate(motion: Motion, time_s: Floats, start: Quaternion) -> Floats:
    """Attitudes (N, 4) at ``time_s`` (N,), from ``start`` at the first.

    Fourth-order Magnus steps: S. Blanes et al., "The Magnus expansion and some
    of its applications", Physics Reports 470 (2009), with two Gauss points.
    """
    interval = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    steps = ceil(interval / LONGEST_STEP_S - 1e-9)
    h = interval / steps
    begin = (time_s[:-1, None] + h * np.arange(steps)[None, :]).ravel()
    w_1 = true_rate(motion, begin + h * (0.5 - 3**0.5 / 6))
    w_2 = true_rate(motion, begin + h * (0.5 + 3**0.5 / 6))
    # R_k+1 = R_k exp([h/2 (w_1 + w_2) + sqrt(3)/12 h^2 (w_1 x w_2)]x)
    phi = h / 2 * (w_1 + w_2) + 3**0.5 / 12 * h**2 * np.cross(w_1, w_2)
    products = running_product(np.vstack([[start], exp(phi)]))
    return products[::steps]
