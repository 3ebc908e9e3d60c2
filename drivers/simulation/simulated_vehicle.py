"""The simulated vehicle: the paper's signals with known truth, seeded.

Source: section "Attitude Measurements and Initialization" of "Nonlinear
Attitude Filter on SO(3): Fast Adaptation and Robustness"::

    Omega_m = Omega + b + n                   n    ~ N(0, 0.2)   (standard deviation)
    v_i^B   = R^T v_i^I + b_i^B + n_i^B       n_i  ~ N(0, 0.05)
    dR/dt   = R [Omega]x,   R(0) = I

as an IMU reads them: acc = -g v_2^B and mag = 0.5 gauss v_1^B, neither
normalised. A block (:func:`simulate`) and a stream (:class:`SimulatedVehicle`)
give the same numbers bit for bit: the truth comes in chunks that start at fixed
samples, and each sample takes nine normal numbers in one order.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, isfinite
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from estimator.errors import InputError
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, Quaternion, Vec3

Floats = npt.NDArray[np.float64]
Motion = Literal["paper", "rest", "turn"]
MOTIONS: tuple[str, ...] = get_args(Motion)

# The paper's inertial vectors (NED, unit length)
MAGNETIC_NED: Vec3 = (1 / 3**0.5, -1 / 3**0.5, 1 / 3**0.5)
GRAVITY_NED: Vec3 = (0.0, 0.0, 1.0)

# The paper's biases and noises: rad/s for the gyroscope, unit vectors for the others
GYRO_BIAS_RAD_S: Vec3 = (-0.1, 0.1, 0.05)
MAGNETIC_BIAS: Vec3 = (0.1, -0.1, 0.1)
GRAVITY_BIAS: Vec3 = (0.0, 0.0, 0.1)
GYRO_NOISE_RAD_S = 0.2
VECTOR_NOISE = 0.05

FIELD_GAUSS = 0.5  # a typical strength of the Earth's field
TURN_RATE_RAD_S = 0.5  # "turn": level, to the right, one round in 12.6 s

# The magnet passes on the vehicle's right: a field along body y that rises and falls smoothly
# between the two times, in the middle as strong as the Earth's
MAGNET_PEAK_GAUSS = 0.5

CHUNK_SAMPLES = 128  # a stream computes this much ahead; 1.3 s at 100 Hz
# Fourth-order steps of 10 ms keep the truth within 1e-9 rad over the paper's 15 s
LONGEST_STEP_S = 0.01


class Sample(NamedTuple):
    """One instant of the simulated vehicle; measured values are in FRD.

    ``time_us`` counts from the vehicle's start. ``q_ned_frd`` and
    ``true_rate_rad_s`` are the truth.
    """

    time_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3
    q_ned_frd: Quaternion
    true_rate_rad_s: Vec3


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """N samples as read-only arrays; the columns are those of :class:`Sample`."""

    time_us: npt.NDArray[np.int64]  # (N,)
    gyr_rad_s: Floats  # (N, 3)
    acc_m_s2: Floats  # (N, 3)
    mag_gauss: Floats  # (N, 3)
    q_ned_frd: Floats  # (N, 4)
    true_rate_rad_s: Floats  # (N, 3)


class _Truth(NamedTuple):
    """What the noise is added to: times, attitude, rate and the two true body vectors."""

    time_us: npt.NDArray[np.int64]
    q_ned_frd: Floats
    rate_rad_s: Floats
    magnetic_frd: Floats
    gravity_frd: Floats


class _Disturbance(NamedTuple):
    """Scale factors of the paper's noise and bias, and the magnet's times in s."""

    noise: float
    bias: float
    magnet: tuple[float, float] | None


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
    _check(rate_hz, motion, noise, bias, magnet)
    if samples < 1:
        raise InputError(f"the simulated vehicle needs at least 1 sample, not {samples}")
    truth = _truth(motion, rate_hz, samples)
    normals = _generator(seed).standard_normal((samples, 9))
    return _measure(truth, normals, _Disturbance(noise, bias, magnet))


class SimulatedVehicle:
    """The same samples as :func:`simulate`, one at a time and forever.

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
    ) -> None:
        _check(rate_hz, motion, noise, bias, magnet)
        self._motion = motion
        self._disturbance = _Disturbance(noise, bias, magnet)
        self._generator = _generator(seed)
        self._last: Sample | None = None
        self._samples = self._from(0, IDENTITY, rate_hz)

    def __iter__(self) -> Iterator[Sample]:
        return self

    def __next__(self) -> Sample:
        self._last = next(self._samples)
        return self._last

    def change_rate(self, rate_hz: float) -> None:
        """Go on with the same motion at another rate, at t = k / ``rate_hz`` after the last sample.

        Raises:
            InputError: the rate is not positive.
        """
        _check(rate_hz, self._motion, self._disturbance.noise, self._disturbance.bias, None)
        if self._last is None:
            self._samples = self._from(0, IDENTITY, rate_hz)
            return
        last_s = self._last.time_us * 1e-6
        first = floor(last_s * rate_hz + 1e-6) + 1
        times = np.array([last_s, first / rate_hz])
        start: Quaternion = tuple(_integrate(self._motion, times, self._last.q_ned_frd)[-1])
        self._samples = self._from(first, start, rate_hz)

    def _from(self, first: int, start: Quaternion, rate_hz: float) -> Iterator[Sample]:
        return _samples(self._generator, rate_hz, self._motion, self._disturbance, first, start)


def true_rate(motion: Motion, time_s: Floats) -> Floats:
    """Omega (rad/s, FRD) at times of shape (N,), as (N, 3)."""
    rate = np.zeros((len(time_s), 3))
    if motion == "paper":
        rate[:, 0] = np.sin(0.4 * time_s)
        rate[:, 1] = np.sin(0.7 * time_s + np.pi / 4)
        rate[:, 2] = 0.4 * np.sin(0.3 * time_s + np.pi / 2)
    elif motion == "turn":
        rate[:, 2] = TURN_RATE_RAD_S
    return rate


def _check(
    rate_hz: float, motion: str, noise: float, bias: float, magnet: tuple[float, float] | None
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


def _generator(seed: int) -> np.random.Generator:
    if seed < 0:
        raise InputError(f"a seed must be 0 or more, not {seed}")
    return np.random.default_rng(seed)


def _samples(
    generator: np.random.Generator,
    rate_hz: float,
    motion: Motion,
    disturbance: _Disturbance,
    first: int,
    start: Quaternion,
) -> Iterator[Sample]:
    """Samples number ``first``, ``first`` + 1, ..., of which the first has attitude ``start``."""
    while True:
        truth, start = _truth_chunk(motion, rate_hz, first, start)
        block = _measure(truth, generator.standard_normal((CHUNK_SAMPLES, 9)), disturbance)
        columns = (
            block.time_us.tolist(),
            map(tuple, block.gyr_rad_s.tolist()),
            map(tuple, block.acc_m_s2.tolist()),
            map(tuple, block.mag_gauss.tolist()),
            map(tuple, block.q_ned_frd.tolist()),
            map(tuple, block.true_rate_rad_s.tolist()),
        )
        yield from map(Sample._make, zip(*columns, strict=True))
        first += CHUNK_SAMPLES


def _measure(truth: _Truth, normals: Floats, disturbance: _Disturbance) -> Recording:
    """Truth plus bias and noise; ``normals`` (N, 9) are gyroscope, v_1, v_2."""
    noise, bias, magnet = disturbance
    # Omega_m = Omega + b + n
    gyr = truth.rate_rad_s + bias * np.array(GYRO_BIAS_RAD_S)
    gyr += noise * GYRO_NOISE_RAD_S * normals[:, 0:3]
    # v_i^B = R^T v_i^I + b_i^B + n_i^B
    v_1 = truth.magnetic_frd + bias * np.array(MAGNETIC_BIAS)
    v_1 += noise * VECTOR_NOISE * normals[:, 3:6]
    v_2 = truth.gravity_frd + bias * np.array(GRAVITY_BIAS)
    v_2 += noise * VECTOR_NOISE * normals[:, 6:9]
    mag = FIELD_GAUSS * v_1
    if magnet is not None:
        mag[:, 1] += _magnet_gauss(truth.time_us.astype(np.float64) * 1e-6, magnet)
    recording = Recording(
        truth.time_us,
        gyr,
        -STANDARD_GRAVITY_M_S2 * v_2,
        mag,
        truth.q_ned_frd,
        truth.rate_rad_s,
    )
    for array in (recording.gyr_rad_s, recording.acc_m_s2, recording.mag_gauss):
        array.setflags(write=False)
    return recording


def _magnet_gauss(time_s: Floats, magnet: tuple[float, float]) -> Floats:
    begin, end = magnet
    phase = np.clip((time_s - begin) / (end - begin), 0.0, 1.0)
    # (4 x (1 - x))^2 is sin^2(pi x) to within 0.07, and the same bit for bit in any block
    bump: Floats = MAGNET_PEAK_GAUSS * (4.0 * phase * (1.0 - phase)) ** 2
    return bump


@lru_cache(maxsize=8)
def _truth(motion: Motion, rate_hz: float, samples: int) -> _Truth:
    """All chunks of the truth up to ``samples``, joined."""
    chunks, start = [], IDENTITY
    for first in range(0, samples, CHUNK_SAMPLES):
        chunk, start = _truth_chunk(motion, rate_hz, first, start)
        chunks.append(chunk)
    columns = [np.concatenate(column)[:samples] for column in zip(*chunks, strict=True)]
    return _read_only(_Truth._make(columns))


@lru_cache(maxsize=8)  # vehicles that fly side by side share the truth
def _truth_chunk(
    motion: Motion, rate_hz: float, first: int, start: Quaternion
) -> tuple[_Truth, Quaternion]:
    """The chunk from sample ``first`` on, whose attitude is ``start``, and the attitude after."""
    k = first + np.arange(CHUNK_SAMPLES + 1)
    time_s = k / rate_hz
    q = _integrate(motion, time_s, start)
    after: Quaternion = tuple((q[-1] / np.sqrt(np.sum(q[-1] ** 2))).tolist())
    q = q[:-1]
    truth = _Truth(
        np.rint(time_s[:-1] * 1e6).astype(np.int64),
        q,
        true_rate(motion, time_s[:-1]),
        _rotate_inverse(q, MAGNETIC_NED),
        _rotate_inverse(q, GRAVITY_NED),
    )
    return _read_only(truth), after


def _read_only(truth: _Truth) -> _Truth:
    for array in truth:
        array.setflags(write=False)
    return truth


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
    products = _running_product(np.vstack([[start], _exponential(phi)]))
    return products[::steps]


def _exponential(phi: Floats) -> Floats:
    """Rotation vectors (N, 3) to unit quaternions (N, 4)."""
    half = 0.5 * np.sqrt(np.sum(phi**2, axis=1))
    q = np.empty((len(phi), 4))
    q[:, 0] = np.cos(half)
    q[:, 1:] = 0.5 * np.sinc(half / np.pi)[:, None] * phi
    return q


def _running_product(q: Floats) -> Floats:
    """q_0, q_0 q_1, q_0 q_1 q_2, ... by doubling."""
    product, reach = q, 1
    while reach < len(q):
        product = np.vstack([product[:reach], _multiply(product[:-reach], product[reach:])])
        reach *= 2
    return product


def _multiply(p: Floats, q: Floats) -> Floats:
    """Hamilton products of two arrays (N, 4)."""
    a, b, c, d = p.T
    e, f, g, h = q.T
    return np.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ],
        axis=1,
    )


def _rotate_inverse(q: Floats, v: Vec3) -> Floats:
    """R^T v for attitudes (N, 4) and one vector: q* v q."""
    vector = np.broadcast_to(np.array([0.0, *v]), q.shape)
    conjugate = q * np.array([1.0, -1.0, -1.0, -1.0])
    return np.ascontiguousarray(_multiply(_multiply(conjugate, vector), q)[:, 1:])
