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
from tuning.calibration.spans import ACC, CONSTANTS, GYR, MAG, Recording, cross_matrix, pieces
from tuning.calibration.trajectory import SHOWN, Trajectory

ROUNDS, STEPS = 3, 2  # readings are summed up anew each round
# Sigmas before anything is read: scales and crossed axes, biases, iron as a share of the field
GYR_SHARE, GYR_RAD_S = 0.01, 0.02
ACC_SHARE, ACC_M_S2 = 0.015, 0.2
MAG_SHARE, MAG_IRON = 0.05, 0.2
# How far they vary from piece to piece, and seem to: temperature, a place's field. The scatter of
# several is learnt from there; of one nobody can tell, but less is not believed.
VARY = np.array([0.001] * 9 + [0.005] * 3 + [0.0015] * 9 + [0.03] * 3 + [0.01] * 9 + [0.01] * 3)
GROUPS = np.repeat(np.arange(6), [9, 3, 9, 3, 9, 3])
WORTH = 6.0  # as many numbers as that supposition counts
# What is believed: combinations of constants of which the recordings have left less than this share
# of the variance before, of a sensor whose twelve are not 0 by this chi-square
LEFT, CHI_SQUARE = 0.3, 40.0
IN_FLIGHT = 3.0  # times as much: errors and lags of velocity look like an accelerometer's
MOST_MISFIT = 0.03  # of the field: beside more, a compass shows nothing
PINNED, NO_SCATTER = 1e6, 1e-6
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

    ``sigma`` has the keys of ``found``, matrices as nine numbers; of one recording it leaves out
    how much its pieces differ. ``left`` says of each key which share of the variance before the
    recordings have left, of a matrix on its diagonal. ``x`` (36,) is the whole result, in the order
    of :mod:`tuning.calibration.spans`, of which ``found`` is what may be believed.
    ``field_misfits`` are shares of the field's strength, ``lags_s`` those of velocity,
    accelerometer and compass behind the gyroscope, each of a recording.
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
    cut = [[Trajectory(piece) for piece in pieces(each)] for each in recordings]
    trajectories = [piece for of_one in cut for piece in of_one]
    problem = _Problem(trajectories)
    for _ in range(ROUNDS):
        problem.improve()
    for each in trajectories:
        if each.has_field and (each.field_misfit > MOST_MISFIT or each.is_field_foreign):
            each.leave_out_field()
    problem.improve()
    x, _ = problem.step()
    for each in trajectories:
        each.believe_sigmas()
    _, unsure = problem.step()
    if len(recordings) == 1:
        problem.leave_out_scatter()
    _, covariance = problem.step()
    sigma = np.sqrt(np.diag(covariance))
    left = (sigma / problem.prior) ** 2
    times = IN_FLIGHT**2 if any(each.has_rates for each in trajectories) else 1.0
    unsure = unsure + times * np.diag(problem.least_variance) / len(trajectories)
    misfits = [[each.field_misfit for each in of_one if each.has_field] for of_one in cut]
    return SensorFit(
        calibration_of(_believed(x, unsure, problem.prior)),
        {key: sigma[at].tolist() for key, at in KEYS.items()},
        {key: float(left[at][:: 4 if "matrix" in key else 1].mean()) for key, at in KEYS.items()},
        x,
        covariance,
        [float(np.mean(of_one)) for of_one in misfits if of_one],
        [np.median([each.lags_s for each in of_one], axis=0).tolist() for of_one in cut],
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


class _Own(NamedTuple):
    """A piece's own step (42,) is by_common @ that of the common constants - alone."""

    alone: Floats
    by_common: Floats
    covariance: Floats  # once the common constants are known


class _Problem:
    """Constants common to pieces, x, and those of each, which vary a little around them."""

    def __init__(self, trajectories: list[Trajectory]) -> None:
        self._trajectories = trajectories
        gyr, acc = [GYR_SHARE] * 9 + [GYR_RAD_S] * 3, [ACC_SHARE] * 9 + [ACC_M_S2] * 3
        self.prior = np.array(gyr + acc + [MAG_SHARE] * 9 + [MAG_IRON] * 3)
        vary = VARY.copy()
        for sigmas in (self.prior, vary):
            sigmas[33:] *= max(each.strength_gauss for each in trajectories)
        self.least_variance = vary**2
        # of one piece it cannot be told from the constants
        self._vary = self.least_variance * (1.0 if len(trajectories) > 1 else NO_SCATTER)
        self._x = np.zeros(CONSTANTS)
        # A common turn of all sensors is what the constants before say: rounding would move it.
        self._turns = _common_turns()
        self._pins = self._turns / self.prior[:, None] ** 2
        self._turn_variance = 1.0 / np.sum(self._turns * self._pins, axis=0)

    def leave_out_scatter(self) -> None:
        """Let all pieces have the same constants from now on."""
        self._vary = NO_SCATTER * self.least_variance

    def improve(self) -> None:
        """A few steps, and what they show of the readings."""
        for _ in range(STEPS):
            self.step()
        for each in self._trajectories:
            each.learn_sigmas()
            each.linearise()

    def step(self) -> tuple[Floats, Floats]:
        """The common constants (36,) after a step of all, and their covariance.

        A piece is tied to them alone, so what is its own is eliminated piece by piece.
        """
        x, tie, common = self._x, 1.0 / self._vary, np.arange(CONSTANTS)
        pins = PINNED * self._pins * self._turn_variance
        normal = np.diag(self.prior**-2) + pins @ self._pins.T
        gradient = normal @ x
        solved: list[_Own] = []
        for each in self._trajectories:
            own, slope = each.normal_equations()
            own[common, common] += tie
            slope[:CONSTANTS] += tie * (each.x - x)
            covariance = cho_solve(cho_factor(own), np.eye(SHOWN))
            by_common = covariance[:, :CONSTANTS] * tie
            normal += np.diag(tie) - tie[:, None] * by_common[:CONSTANTS]
            gradient += tie * (x - each.x) + by_common.T @ slope
            solved.append(_Own(covariance @ slope, by_common, covariance))
        covariance = cho_solve(cho_factor(normal), np.eye(CONSTANTS))
        step = -covariance @ gradient
        self._x = x + step
        for each, one in zip(self._trajectories, solved, strict=True):
            each.move(one.by_common @ step - one.alone)
        if len(solved) > 1:
            self._learn_scatter(covariance, solved)
        of_turn = (self._turns * self._turn_variance) @ self._turns.T
        return self._x, covariance + of_turn

    def _learn_scatter(self, covariance: Floats, solved: list[_Own]) -> None:
        """The variance of what the pieces have of their own: its expected square."""
        squares = []
        for each, one in zip(self._trajectories, solved, strict=True):
            apart = one.by_common[:CONSTANTS] - np.eye(CONSTANTS)
            unsure = np.diag(one.covariance[:CONSTANTS, :CONSTANTS] + apart @ covariance @ apart.T)
            squares.append((each.x - self._x) ** 2 + unsure)
        expected = np.mean(squares, axis=0)
        for group in range(6):
            of: Bools = np.equal(group, GROUPS)
            count = len(solved) * of.sum()
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
