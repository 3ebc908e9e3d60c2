"""Readings between two nodes of a trajectory summed up, with what the constants make of them.

The 36 constants x are, for gyroscope, accelerometer and compass in turn, nine numbers of a matrix
D, row after row, and three of b. Of the first two a reading y is corrected to y + D y - b; of a
field u a compass reads u + D u + b.
Preintegration: C. Forster et al., "On-Manifold Preintegration for Real-Time Visual-Inertial
Odometry", IEEE Transactions on Robotics 33(1), 2017, doi 10.1109/TRO.2016.2597321.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.types import Bools, Floats, Ints

PIECE_S = 30.0  # of a recording, about: errors that turn with it are alike for no longer
PARTS = 6  # at least
SPAN_S = 0.2  # between two nodes
LONGEST_STEP_S = 0.5  # between two samples: what is longer is not bridged
MOST_FIELDS = 10  # readings of the field that are used of a span, about
CONSTANTS = 36
LEAST_VELOCITIES = 10  # of a piece of a flight
GYR, ACC, MAG = slice(0, 12), slice(12, 24), slice(24, 36)


class Recording(NamedTuple):
    """Readings (N, 3) of one IMU, FRD, at times (N,), and attitudes (N, 4) to begin with.

    The field (gauss) counts where ``has_mag``. Velocities (M, 3) in NED, m/s, have times of their
    own and are empty where none were reported. ``field_ned_gauss`` is the place's, if known.
    """

    time_s: Floats
    gyr_rad_s: Floats
    acc_m_s2: Floats
    mag_gauss: Floats
    has_mag: Bools
    q_ned_frd: Floats
    velocity_time_s: Floats
    velocity_ned_m_s: Floats
    field_ned_gauss: Floats | None = None


def pieces(recording: Recording) -> Iterator[Recording]:
    """A recording in equal parts; of a flight those that have velocities."""
    n, time_s, velocity_s = len(recording.time_s), recording.time_s, recording.velocity_time_s
    count, least = max(PARTS, round((time_s[-1] - time_s[0]) / PIECE_S)), 0
    if len(velocity_s):
        least = LEAST_VELOCITIES
        count = max(1, min(count, len(velocity_s) // least))
    for k in range(count):
        rows = slice(k * n // count, (k + 1) * n // count)
        first_s, last_s = time_s[rows][[0, -1]]
        beside = (velocity_s >= first_s) & (velocity_s <= last_s)
        if beside.sum() >= least:
            *readings, _, velocity_ned_m_s, field = recording
            velocities = velocity_s[beside], velocity_ned_m_s[beside]
            yield Recording._make([*(each[rows] for each in readings), *velocities, field])


class Spans(NamedTuple):
    """K spans: how far each turns and is pushed, and the mean field in the axes of its begin.

    ``x_by_y`` are derivatives of x: of the turn as a rotation vector at its end. Lags are of
    accelerometer and compass behind the gyroscope.
    """

    lasts_s: Floats  # (K,)
    is_whole: Bools  # (K,): no reading is missing
    has_field: Bools  # (K,)
    turn: Floats  # (K, 3, 3)
    push: Floats  # (K, 3), m/s
    field: Floats  # (K, 3), gauss
    turn_by_gyr: Floats  # (K, 3, 12)
    push_by_gyr: Floats  # (K, 3, 12)
    push_by_acc: Floats  # (K, 3, 12)
    push_by_lag: Floats  # (K, 3)
    field_by_gyr: Floats  # (K, 3, 12)
    field_by_lag: Floats  # (K, 3)
    turned: Floats  # (K, 3, 3), mean of the turns T since the begin
    turned_twice: Floats  # (K, 3, 3, 3, 3), mean of T_ia T_jb


def spans_of(recording: Recording, rows: Ints, x: Floats) -> Spans:
    """The spans between nodes at these rows, by constants x (36,)."""
    step, begin, time_s = int(rows[1] - rows[0]), rows[:-1], recording.time_s
    read_gyr, read_acc, read_mag = recording.gyr_rad_s, recording.acc_m_s2, recording.mag_gauss
    gyr, acc = corrected(read_gyr, x[GYR]), corrected(read_acc, x[ACC])
    jerk, flow = (np.gradient(y, time_s, axis=0) for y in (acc, read_mag))
    k, every = len(begin), max(1, step // MOST_FIELDS)
    count, longest_s, none = np.zeros(k), np.zeros(k), np.zeros(k, np.bool_)
    vector, by = (3,), (3, 12)
    shapes = vector, vector, by, by, by, vector, by, vector, (3, 3), (3, 3, 3, 3)
    sums = (np.zeros((k, *shape)) for shape in shapes)
    s = Spans(time_s[rows[1:]] - time_s[begin], none, none, np.tile(np.eye(3), (k, 1, 1)), *sums)
    for j in range(step):
        at = begin + j
        dt = time_s[at + 1] - time_s[at]
        longest_s = np.maximum(longest_s, dt)
        if j % every == 0:
            there = recording.has_mag[at].astype(float)
            T = s.turn * there[:, None, None]
            count += there
            s.field[:] += times(T, read_mag[at])
            s.field_by_lag[:] += times(T, flow[at])
            s.field_by_gyr[:] -= T @ cross_matrix(read_mag[at] - x[33:]) @ s.turn_by_gyr
            s.turned[:] += T
            s.turned_twice[:] += np.einsum("kia,kjb->kiajb", T, s.turn)
        # halfway through the step, then to its end
        half = rotation(0.25 * dt[:, None] * (gyr[at] + gyr[at + 1]))
        by_half = 0.5 * _by_constants(0.5 * (read_gyr[at] + read_gyr[at + 1]), dt)
        back = np.swapaxes(half, 1, 2)
        s.turn[:], s.turn_by_gyr[:] = s.turn @ half, back @ s.turn_by_gyr + by_half
        push = 0.5 * dt[:, None] * (acc[at] + acc[at + 1])
        s.push[:] += times(s.turn, push)
        s.push_by_lag[:] += times(s.turn, dt[:, None] * jerk[at])
        s.push_by_gyr[:] -= s.turn @ cross_matrix(push) @ s.turn_by_gyr
        s.push_by_acc[:] += s.turn @ _by_constants(0.5 * (read_acc[at] + read_acc[at + 1]), dt)
        s.turn[:], s.turn_by_gyr[:] = s.turn @ half, back @ s.turn_by_gyr + by_half
    for total in (s.field, s.field_by_lag, s.field_by_gyr, s.turned, s.turned_twice):
        total[:] /= np.maximum(count, 1.0).reshape(-1, *(1,) * (total.ndim - 1))
    return s._replace(is_whole=longest_s < LONGEST_STEP_S, has_field=count > 0)


def corrected(y: Floats, x: Floats) -> Floats:
    """Readings (N, 3) as y + D y - b, of a sensor's twelve constants."""
    return np.asarray(y + y @ x[:9].reshape(3, 3).T - x[9:])


def _by_constants(y: Floats, factor: Floats) -> Floats:
    """The derivative (K, 3, 12) of ``factor`` (K,) times a corrected reading (K, 3)."""
    by = np.zeros((len(y), 3, 12))
    for i in range(3):
        by[:, i, 3 * i : 3 * i + 3] = factor[:, None] * y
        by[:, i, 9 + i] = -factor
    return by


def times(R: Floats, v: Floats) -> Floats:
    """R v of rows."""
    return np.asarray((R @ v[:, :, None])[:, :, 0])


def cross_matrix(v: Floats) -> Floats:
    """[v]x of (..., 3), (..., 3, 3)."""
    return np.asarray(np.cross(np.eye(3), v[..., None, :]))


def rotation(phi: Floats) -> Floats:
    """exp [phi]x of (K, 3), (K, 3, 3)."""
    return np.asarray(Rotation.from_rotvec(phi).as_matrix())
