"""The constant errors of an IMU's sensors and the trajectories together, by one fit.

Gauss's and Newton's least squares with a robust loss over all recordings of a sensor. Readings that
constants were not fitted to have to agree better with them, or nothing is wrong. A turn of all
three sensors alike shows in no recording.
"""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimator.calibration import Calibration
from estimator.types import Floats
from tuning.calibration.cross_validation import COMMON_TURNS, IN_FLIGHT, KEYS, PINNED, predicted
from tuning.calibration.spans import ACC, CONSTANTS, GYR, MAG, PARTS, Recording, pieces
from tuning.calibration.trajectory import SHOWN, Trajectory

ROUNDS, STEPS = 3, 2  # readings are summed up anew each round
# Sigmas before anything is read: scales and crossed axes, biases, iron as a share of the field
PRIOR = np.array([0.01] * 9 + [0.02] * 3 + [0.015] * 9 + [0.2] * 3 + [0.05] * 9 + [0.2] * 3)
# How far they vary from piece to piece, and seem to: temperature, a place's field
VARY = np.array([0.001] * 9 + [0.005] * 3 + [0.0015] * 9 + [0.03] * 3 + [0.01] * 9 + [0.01] * 3)
NO_SCATTER = 1e-6
LEAST_RECORDINGS = 3  # from so many on each is left out as a whole; of fewer, sixths


class SensorFit(NamedTuple):
    """The constants found, and how sure they are.

    ``sigma`` has the keys of ``found``, matrices as nine numbers; of one recording it leaves out
    how much its pieces differ. ``left`` is the share of each key's variance before that the
    recordings have left, of a matrix on its diagonal, and ``predicted`` the share of what it would
    win of a part of the recordings that it wins by all others; ``found`` has those that win half.
    """

    found: Calibration
    sigma: dict[str, list[float]]
    left: dict[str, float]
    predicted: dict[str, float]
    x: Floats  # (36,), the whole result in the order of :mod:`tuning.calibration.spans`
    field_misfits: list[float]  # shares of the field's strength, of each recording
    lags_s: list[list[float]]  # of velocity, accelerometer and compass behind the gyroscope


def fit_sensors(recordings: Sequence[Recording]) -> SensorFit:
    """What is wrong with the sensors of one IMU, of which there may be several recordings."""
    cut = [[Trajectory(piece) for piece in pieces(each)] for each in recordings]
    trajectories = [piece for of_one in cut for piece in of_one]
    if not trajectories:
        raise np.linalg.LinAlgError("too few velocities")
    problem = _Problem(trajectories)
    for _ in range(ROUNDS):
        problem.improve()
    for each in trajectories:
        each.leave_foreign_field()
    problem.improve()
    x, _ = problem.step()
    parts = np.concatenate([np.arange(len(of_one)) * PARTS // len(of_one) for of_one in cut])
    if len(recordings) >= LEAST_RECORDINGS:
        parts = np.repeat(np.arange(len(cut)), [len(of_one) for of_one in cut])
    keys = IN_FLIGHT if any(each.has_rates for each in trajectories) else KEYS
    A, b = map(np.array, zip(*problem.seen, strict=True))
    shares, believed = predicted(A, b, parts, problem.prior, keys)
    for each in trajectories:
        each.believe_sigmas()
    if len(recordings) == 1:
        problem.vary *= NO_SCATTER  # all pieces have the same constants
    _, covariance = problem.step()
    sigma = np.sqrt(np.diag(covariance))
    left = (sigma / problem.prior) ** 2
    misfits = [[m for each in of_one if (m := each.field_misfit) is not None] for of_one in cut]
    return SensorFit(
        calibration_of(problem.prior * believed),
        {key: sigma[at].tolist() for key, at in KEYS.items()},
        {key: float(left[at][:: 4 if "matrix" in key else 1].mean()) for key, at in KEYS.items()},
        shares,
        x,
        [float(np.mean(of_one)) for of_one in misfits if of_one],
        [np.median([each.lags_s for each in of_one], axis=0).tolist() for of_one in cut],
    )


def calibration_of(x: Floats) -> Calibration:
    """Constants (36,) as a profile has them: v = M (reading - b)."""
    gyr, acc = (np.eye(3) + x[part][:9].reshape(3, 3) for part in (GYR, ACC))
    mag = np.linalg.inv(np.eye(3) + x[MAG][:9].reshape(3, 3))
    biases = np.linalg.solve(gyr, x[GYR][9:]), np.linalg.solve(acc, x[ACC][9:]), x[MAG][9:]
    found = [value for each in zip(biases, (gyr, acc, mag), strict=True) for value in each]
    keys = {key: value.round(6).tolist() for key, value in zip(KEYS, found, strict=True)}
    return msgspec.convert(keys, Calibration)


class _Problem:
    """Constants common to pieces, x, and those of each, which vary a little around them."""

    def __init__(self, trajectories: list[Trajectory]) -> None:
        self._trajectories = trajectories
        unit = np.ones(CONSTANTS)
        unit[33:] = max(each.strength_gauss for each in trajectories)
        self.prior, self.vary = PRIOR * unit, (VARY * unit) ** 2
        self._x = np.zeros(CONSTANTS)
        # A common turn of all sensors is that of the constants before: rounding would move it.
        self._pins = COMMON_TURNS / self.prior[:, None] ** 2
        self._turn_variance = 1.0 / np.sum(COMMON_TURNS * self._pins, axis=0)
        # What each piece showed in the last step: A (36, 36) and b (36,) of its loss
        # x.A x / 2 - b.x, of constants x in units of their sigmas before.
        self.seen: list[tuple[Floats, Floats]] = []

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
        x, tie, common = self._x, 1.0 / self.vary, np.arange(CONSTANTS)
        pins = PINNED * self._pins * self._turn_variance
        normal = np.diag(self.prior**-2) + pins @ self._pins.T
        gradient = normal @ x
        solved: list[tuple[Floats, Floats]] = []
        self.seen = []
        for each in self._trajectories:
            own, slope = each.normal_equations()
            own[common, common] += tie
            slope[:CONSTANTS] += tie * (each.x - x)
            covariance = cho_solve(cho_factor(own), np.eye(SHOWN))
            by_common = covariance[:, :CONSTANTS] * tie
            of_common = np.diag(tie) - tie[:, None] * by_common[:CONSTANTS]
            downhill = tie * (each.x - x) - by_common.T @ slope
            normal += of_common
            gradient -= downhill
            A, b = of_common * np.outer(self.prior, self.prior), of_common @ x + downhill
            self.seen.append((A, b * self.prior))
            solved.append((by_common, covariance @ slope))
        covariance = cho_solve(cho_factor(normal), np.eye(CONSTANTS))
        step = -covariance @ gradient
        self._x = x + step
        for each, (by_common, alone) in zip(self._trajectories, solved, strict=True):
            each.move(by_common @ step - alone)
        of_turn = (COMMON_TURNS * self._turn_variance) @ COMMON_TURNS.T
        return self._x, covariance + of_turn
