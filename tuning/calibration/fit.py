"""The constant errors of an IMU's sensors and the trajectories together, by one fit.

Gauss's and Newton's least squares with a robust loss over all recordings of a sensor. What they do
not show stays at what is supposed before: nothing is wrong, within the sigmas below. A turn of all
three sensors alike shows in no recording.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimator.arrays import Bools, Floats
from estimator.calibration import Calibration, Matrix
from estimator.types import Vec3
from tuning.calibration.spans import ACC, CONSTANTS, GYR, MAG, Recording, cross_matrix
from tuning.calibration.trajectory import SHOWN, Trajectory

ROUNDS, STEPS = 3, 2  # readings are summed up anew each round
# Sigmas before anything is read: scales and crossed axes, biases, iron as a share of the field
GYR_SHARE, GYR_RAD_S = 0.01, 0.02
ACC_SHARE, ACC_M_S2 = 0.015, 0.2
MAG_SHARE, MAG_IRON = 0.05, 0.2
# How far they vary from recording to recording, and seem to: temperature, a place's field. The
# scatter of several is learnt from there; of one nobody can tell, but less is not believed.
VARY = np.array([0.001] * 9 + [0.005] * 3 + [0.0015] * 9 + [0.03] * 3 + [0.01] * 9 + [0.01] * 3)
GROUPS = np.repeat(np.arange(6), [9, 3, 9, 3, 9, 3])
WORTH = 6.0  # as many numbers as that supposition counts
# What is believed: combinations of constants of which the recordings have left less than this share
# of the variance before, of a sensor whose twelve are not 0 by this chi-square
LEFT, CHI_SQUARE = 0.3, 40.0
IN_FLIGHT = 3.0  # times as much: errors and lags of velocity look like an accelerometer's
MOST_MISFIT = 0.03  # of the field: beside more, a compass shows nothing
PINNED = 1e6
KEYS = {
    "gyr_bias_rad_s": slice(9, 12),
    "gyr_matrix": slice(0, 9),
    "acc_bias_m_s2": slice(21, 24),
    "acc_matrix": slice(12, 21),
    "mag_offset_gauss": slice(33, 36),
    "mag_matrix": slice(24, 33),
}


class SensorFit(NamedTuple):
    """The constants found, and how sure they are.

    ``sigma`` has the keys of ``found``, matrices as nine numbers; ``left`` says of each key which
    share of the variance before the recordings have left, of a matrix on its diagonal. ``x`` (36,)
    is the whole result, in the order of :mod:`tuning.calibration.spans`, of which ``found`` is what
    may be believed. ``field_misfits`` are shares of the field's strength, ``lags_s`` those of
    velocity, accelerometer and compass behind the gyroscope, each of a recording.
    """

    found: Calibration
    sigma: dict[str, list[float]]
    left: dict[str, float]
    x: Floats
    covariance: Floats
    field_misfits: list[float]
    lags_s: list[list[float]]


def fit_sensors(recordings: Sequence[Recording]) -> SensorFit:
    """What is wrong with the sensors of one IMU, of which there may be several recordings."""
    trajectories = [Trajectory(recording) for recording in recordings]
    problem = _Problem(trajectories)
    for _ in range(ROUNDS):
        problem.improve()
    for each in trajectories:
        if each.has_field and each.field_misfit > MOST_MISFIT:
            each.leave_out_field()
    problem.improve()
    x, _ = problem.step()
    for each in trajectories:
        each.believe_sigmas()
    _, covariance = problem.step()
    sigma = np.sqrt(np.diag(covariance))
    left = (sigma / problem.prior) ** 2
    times = IN_FLIGHT**2 if any(each.has_rates for each in trajectories) else 1.0
    unsure = covariance + times * np.diag(problem.least_variance) / len(trajectories)
    return SensorFit(
        calibration_of(_believed(x, unsure, problem.prior)),
        {key: sigma[at].tolist() for key, at in KEYS.items()},
        {key: float(left[at][:: 4 if "matrix" in key else 1].mean()) for key, at in KEYS.items()},
        x,
        covariance,
        [each.field_misfit for each in trajectories if each.has_field],
        [each.lags_s.tolist() for each in trajectories],
    )


def calibration_of(x: Floats) -> Calibration:
    """Constants (36,) as a profile has them: v = M (reading - b)."""
    gyr, acc = (np.eye(3) + x[part][:9].reshape(3, 3) for part in (GYR, ACC))
    mag = np.linalg.inv(np.eye(3) + x[MAG][:9].reshape(3, 3))
    return Calibration(
        gyr_bias_rad_s=_vector(np.linalg.solve(gyr, x[GYR][9:])),
        gyr_matrix=_matrix(gyr),
        acc_bias_m_s2=_vector(np.linalg.solve(acc, x[ACC][9:])),
        acc_matrix=_matrix(acc),
        mag_offset_gauss=_vector(x[MAG][9:]),
        mag_matrix=_matrix(mag),
    )


def _vector(v: Any) -> Vec3:
    x, y, z = v.round(6).tolist()
    return (x, y, z)


def _matrix(m: Any) -> Matrix:
    a, b, c = (_vector(row) for row in m)
    return (a, b, c)


class _Problem:
    """Constants common to recordings, x, and those of each, which vary a little around them."""

    def __init__(self, trajectories: list[Trajectory]) -> None:
        self._trajectories = trajectories
        gyr, acc = [GYR_SHARE] * 9 + [GYR_RAD_S] * 3, [ACC_SHARE] * 9 + [ACC_M_S2] * 3
        self.prior = np.array(gyr + acc + [MAG_SHARE] * 9 + [MAG_IRON] * 3)
        vary = VARY.copy()
        for sigmas in (self.prior, vary):
            sigmas[33:] *= max(each.strength_gauss for each in trajectories)
        self.least_variance = vary**2
        # of one recording it cannot be told from the constants
        self._vary = self.least_variance * (1.0 if len(trajectories) > 1 else 1e-6)
        self._x = np.zeros(CONSTANTS)
        # A common turn of all sensors is what the constants before say: rounding would move it.
        self._turns = _common_turns()
        self._pins = self._turns / self.prior[:, None] ** 2
        self._turn_variance = 1.0 / np.sum(self._turns * self._pins, axis=0)

    def improve(self) -> None:
        """A few steps, and what they show of the readings."""
        for _ in range(STEPS):
            self.step()
        for each in self._trajectories:
            each.learn_sigmas()
            each.linearise()

    def step(self) -> tuple[Floats, Floats]:
        """The common constants (36,) after a step of all, and their covariance."""
        many, common = self._trajectories, np.arange(CONSTANTS)
        size = CONSTANTS + SHOWN * len(many)
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        normal[common, common], gradient[common] = self.prior**-2, self._x / self.prior**2
        pins = PINNED * self._pins * self._turn_variance
        normal[:CONSTANTS, :CONSTANTS] += pins @ self._pins.T
        gradient[common] += pins @ (self._pins.T @ self._x)
        places = [CONSTANTS + SHOWN * k + np.arange(SHOWN) for k in range(len(many))]
        for at, each in zip(places, many, strict=True):
            normal[np.ix_(at, at)], gradient[at] = each.normal_equations()
            own, tie = at[:CONSTANTS], 1.0 / self._vary
            normal[common, common] += tie
            normal[own, own] += tie
            normal[common, own] = normal[own, common] = -tie
            gradient[common] += tie * (self._x - each.x)
            gradient[own] += tie * (each.x - self._x)
        factor = cho_factor(normal)
        step, covariance = -cho_solve(factor, gradient), cho_solve(factor, np.eye(size))
        self._x = self._x + step[common]
        for at, each in zip(places, many, strict=True):
            each.move(step[at])
        if len(many) > 1:
            self._learn_scatter(covariance, places)
        of_turn = (self._turns * self._turn_variance) @ self._turns.T
        return self._x, covariance[:CONSTANTS, :CONSTANTS] + of_turn

    def _learn_scatter(self, covariance: Floats, places: list[Any]) -> None:
        """The variance of what the recordings have of their own: its expected square."""
        common, squares = np.arange(CONSTANTS), []
        for at, each in zip(places, self._trajectories, strict=True):
            own = at[:CONSTANTS]
            unsure = covariance[common, common] + covariance[own, own]
            squares.append((each.x - self._x) ** 2 + unsure - 2.0 * covariance[common, own])
        expected = np.mean(squares, axis=0)
        for group in range(6):
            of: Bools = np.equal(group, GROUPS)
            count = len(places) * of.sum()
            total = count * expected[of].mean() + WORTH * self.least_variance[of][0]
            self._vary[of] = total / (count + WORTH)


def _common_turns() -> Floats:
    """The constants (36, 3) of a small turn of all three sensors about each axis."""
    turn, none = cross_matrix(np.eye(3)).reshape(3, 9), np.zeros((3, 3))
    return np.concatenate([turn, none, turn, none, -turn, none], axis=1).T


def _believed(x: Floats, covariance: Floats, prior: Floats) -> Floats:
    """The part of the constants (36,) that the recordings show."""
    variances, ways = np.linalg.eigh(covariance / np.outer(prior, prior))
    believed: Floats = prior * (ways @ (ways.T @ (x / prior) * (variances < LEFT)))
    for sensor in (GYR, ACC, MAG):
        part = believed[sensor]
        if part @ np.linalg.solve(covariance[sensor, sensor], part) < CHI_SQUARE:
            believed[sensor] = 0.0
    return believed
