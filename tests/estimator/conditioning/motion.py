"""Vehicles whose truth is known, for the tests of the steps."""

from collections.abc import Callable, Iterable, Iterator
from math import cos, pi, sin
from typing import NamedTuple

import numpy as np

from estimator.conditioning.condition import Conditioned, condition
from estimator.conditioning.gather import NOTHING, Gathered
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.rate import is_mean
from estimator.conditioning.state import ConditioningState, initial_state
from estimator.conditioning.vertical.lowpass import Smooth, smooth
from estimator.geometry import quaternion as qn
from estimator.live import kernel_handle
from estimator.live.core import in_arrays, initial_core
from estimator.live.settings import settings_of
from estimator.live.situation import Situation
from estimator.profile import load_profile
from estimator.types import IDENTITY, NO_SAMPLE, Quaternion, Vec3
from estimator.types import Sample as Reading

PARAMS = ConditioningParams()
GRAVITY_M_S2 = 9.81
FIELD_NED = (0.2, 0.0, 0.42)  # 65 degrees of dip


class Sample(NamedTuple):
    """What the sensors read and the attitude they read it at."""

    q_ned_frd: Quaternion = IDENTITY
    gyr: Vec3 = (0.0, 0.0, 0.0)
    acc: Vec3 = (0.0, 0.0, -GRAVITY_M_S2)
    mag: Vec3 = FIELD_NED
    has_mag: bool = True


def tumbling(t: float) -> Vec3:
    """Body rates (rad/s) that reach every attitude."""
    return (1.5 * sin(0.9 * t), 1.2 * cos(0.7 * t + 1.0), 0.8 * sin(0.5 * t + 2.0))


def hand(t: float) -> Vec3:
    """Body rates (rad/s) of a hand that turns quickly."""
    return (3.0 * sin(2.1 * t + 1.0), 2.5 * cos(1.7 * t), 2.0 * sin(1.3 * t + 2.0))


def resting(_t: float) -> Vec3:
    """No rate."""
    return (0.0, 0.0, 0.0)


def turned(q: Quaternion, rate_rad_s: Vec3, dt: float) -> Quaternion:
    """The attitude after a step with a body rate."""
    return qn.normalize(qn.multiply(q, qn.exp(qn.scale(dt, rate_rad_s))))


def fly(
    rate: Callable[[float], Vec3],
    seconds: float,
    dt: float,
    *,
    bias: Vec3 = (0.0, 0.0, 0.0),
    lag_s: float = 0.0,
    offset: Vec3 = (0.0, 0.0, 0.0),
) -> Iterator[Sample]:
    """A vehicle that only turns, with a late magnetometer; a reading is a mean if taken for one."""
    q = IDENTITY
    history = [q]
    behind = round(lag_s / dt)
    for k in range(round(seconds / dt)):
        w = rate(k * dt)
        part = 0.5 * dt if is_mean(dt, averaged=False) else dt
        felt = qn.rotate_inverse(turned(q, w, part), (0.0, 0.0, -GRAVITY_M_S2))
        q = turned(q, w, dt)
        history.append(q)
        then = history[max(0, len(history) - 1 - behind)]
        mag = qn.add(qn.rotate_inverse(then, FIELD_NED), offset)
        yield Sample(q, qn.add(w, bias), felt, mag)


def pushed(sample: Sample, push_ned: Vec3) -> Sample:
    """The sample of a vehicle that accelerates, m/s^2."""
    return sample._replace(acc=qn.add(sample.acc, qn.rotate_inverse(sample.q_ned_frd, push_ned)))


def in_field(sample: Sample, field_ned: Vec3) -> Sample:
    """The sample in another field, gauss."""
    return sample._replace(mag=qn.rotate_inverse(sample.q_ned_frd, field_ned))


def swayed_hand(
    seed, seconds=10.0, push_m_s2=3.0, rates_hz=(0.5, 0.7, 0.9), turning=1.0, begin_s=0.0
):
    """A hand that turns, and accelerates to and fro along each axis from a time on; 100 Hz."""
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * pi, 3)
    for k, s in enumerate(fly(lambda t: qn.scale(turning, hand(t + 10.0 * seed)), seconds, 0.01)):
        push = push_m_s2 * np.cos(2.0 * pi * np.array(rates_hz) * 0.01 * k + phases)
        yield pushed(s, tuple(push.tolist())) if 0.01 * k >= begin_s else s


class Memory(NamedTuple):
    """All that the stage remembers from one sample to the next."""

    known: ConditioningState
    gathered: Gathered = NOTHING


SETTINGS = settings_of(load_profile("imu"))
step = kernel_handle.takes_handle(NO_SAMPLE)(condition)


class Stage:
    """The conditioning stage alone, compiled, behind ``memory``."""

    def __init__(self, params: ConditioningParams, memory: Memory | None = None) -> None:
        known, gathered = memory or Memory(initial_state(params))
        core = in_arrays(initial_core(SETTINGS))._replace(conditioning=known, gathered=gathered)
        chosen = SETTINGS._replace(conditioning=params)
        rows = kernel_handle.NO_ROWS_BOUND
        self._handle = kernel_handle.new_handle(chosen, core, Situation(), *rows)

    def take(self, sample: Reading) -> tuple[Conditioned, Memory]:
        """What becomes of a sample, and what is remembered behind it."""
        out, core = step(self._handle, sample), kernel_handle.contents(self._handle)
        return out, Memory(core.conditioning, core.gathered)


def conditioned(
    samples: Iterable[Sample],
    dt: float,
    params: ConditioningParams = PARAMS,
    memory: Memory | None = None,
) -> Iterator[tuple[Sample, Conditioned, Memory]]:
    """Each sample, what becomes of it, and what is remembered behind it."""
    stage = Stage(params, memory)
    for s in samples:
        yield s, *stage.take(Reading(s.gyr, s.acc, s.mag, s.has_mag, dt))


def vector_errors_rad(out: Conditioned, q_ned_frd: Quaternion) -> tuple[float, float]:
    """How far gravity and north lie from those of the true attitude."""
    down, north = (qn.rotate_inverse(q_ned_frd, v) for v in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
    apart_rad = qn.angle_between_vectors
    return apart_rad(out.gravity_b, down), apart_rad(out.magnetic_b, north)


def inclinations(samples, dt, params=PARAMS, memory=None):
    """Error and sigma of each sample's inclination (2, N), degrees."""
    found = [
        (vector_errors_rad(out, s.q_ned_frd)[0], out.sigma_inclination_rad)
        for s, out, _ in conditioned(samples, dt, params, memory)
    ]
    return np.degrees(found).T


def smooth_scalar(k, y, w, u):
    """A step of the low-pass for one channel: its value and slope."""
    after = smooth(k, Smooth((y, 0.0, 0.0), (w, 0.0, 0.0)), (u, 0.0, 0.0))
    return after.value[0], after.slope[0]
