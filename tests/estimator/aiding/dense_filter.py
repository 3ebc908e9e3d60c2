"""The aiding's Kalman filter once more, in dense matrices and from its models.

Rows of the velocity are numerical derivatives of a report. The product calls nothing here, and this
file uses nothing of the product's filter but its constants.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.aiding import types

G_NED = np.array([0.0, 0.0, 9.80665])
STEP = 1e-6


def floats(vector):
    return tuple(float(v) for v in vector)


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def matrix_of(q):
    """(3, 3) of a quaternion, scalar first."""
    return Rotation.from_quat([*q[1:], q[0]]).as_matrix()


def turned(t):
    """(3, 3) of a rotation vector."""
    return Rotation.from_rotvec(t).as_matrix()


def three(first):
    return slice(first, first + 3)


@dataclass
class Dense:
    """Covariance (SIZE, SIZE) and corrections (SIZE,) within one step."""

    P: np.ndarray
    x: np.ndarray

    def learn(self, h, innovation, noise):
        """One Kalman update by a scalar = h . errors + noise, Joseph's form."""
        S = h @ self.P @ h + noise
        K = self.P @ h / S
        left = np.eye(types.SIZE) - np.outer(K, h)
        self.x = self.x + K * (innovation - h @ self.x)
        self.P = left @ self.P @ left.T + noise * np.outer(K, K)


def predicted(P, R, gained, dt, keep_receiver, keep_filter):
    """F P F' of one step, with the share of the slow errors that stays."""
    F = np.eye(types.SIZE)
    F[three(types.TURN), three(types.GYR_BIAS)] = -R * dt
    F[three(types.VELOCITY), three(types.ACC_BIAS)] = -R * dt
    F[three(types.VELOCITY), three(types.TURN)] = -skew(gained)
    F[three(types.RECEIVER_ERROR), three(types.RECEIVER_ERROR)] *= keep_receiver
    F[three(types.FILTER_ERROR), three(types.FILTER_ERROR)] *= keep_filter
    return F @ P @ F.T


def velocity_then(times_s, accelerations, age_s, now_m_s, turn):
    """The velocity ``age_s`` ago, the attitude turned by ``turn``; ``times_s`` (N,) end at 0."""
    between = times_s[times_s > -age_s]
    at = np.concatenate([[-age_s], between])
    forces = np.array(
        [
            [np.interp(t, times_s, accelerations[:, i]) for i in range(3)] - G_NED
            for t in at  # what was felt: without gravity
        ]
    )
    pushed = np.trapezoid(forces, at, axis=0)
    return now_m_s - turned(turn) @ pushed - G_NED * age_s


def velocity_row(times_s, accelerations, age_s, v, slow, i, error_at, lag_at, knows_lag):
    """Component i of a report, and how it changes with each error."""

    def reported(e):
        age = age_s + e[lag_at] - (e[types.IMU_LAG] if knows_lag else 0.0)
        then = velocity_then(
            times_s, accelerations, age, v + e[three(types.VELOCITY)], e[three(types.TURN)]
        )
        return then[i] + slow[i] + e[error_at + i]

    h = np.zeros(types.SIZE)
    for k in range(types.SIZE):
        e = np.zeros(types.SIZE)
        e[k] = STEP
        h[k] = (reported(e) - reported(-e)) / (2.0 * STEP)
    return reported(np.zeros(types.SIZE)), h


def field_rows(q_then, turn, rate, m, E):
    """F and the rows of (E - F) in NED: (3,), (3, SIZE); the compass is turned about down."""
    R = matrix_of(q_then) @ turned([0.0, 0.0, -turn])
    F = R @ m
    rows = np.zeros((3, types.SIZE))
    rows[:, three(types.TURN)] = -skew(F)  # turn x F
    rows[:, three(types.HARD_IRON)] = -R
    rows[:, types.COMPASS_TURN] = -np.cross(R[:, 2], F)
    rows[:, types.FIELD_LAG] = -np.cross(matrix_of(q_then) @ rate, F)
    rows[:, three(types.EARTH)] = -np.eye(3)
    return F, rows


def sources():
    """Where each reporter's error and lag stand among the errors: receiver, filter."""
    return {
        True: (types.RECEIVER_ERROR, types.RECEIVER_LAG),
        False: (types.FILTER_ERROR, types.FILTER_LAG),
    }
