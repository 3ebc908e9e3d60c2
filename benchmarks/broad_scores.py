"""Errors as in BROAD's own evaluation, and recovery from an unsensed turn."""

from typing import NamedTuple

import numpy as np
from broad_data import Array, Trial

RECOVERED_DEG = 5.0


class Score(NamedTuple):
    """RMS errors of one trial, degrees."""

    total: float
    heading: float
    inclination: float


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product, rows or single quaternions."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """The inverse of unit quaternions."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def errors_deg(estimate: Array, truth: Array) -> tuple[Array, Array, Array]:
    """Total 2 acos|w|, heading 2 atan|z/w|, inclination 2 acos sqrt(w^2 + z^2) of q_est q_true*."""
    w, _, _, z = multiply(estimate, conjugate(truth)).T
    total = 2.0 * np.arccos(np.clip(np.abs(w), 0.0, 1.0))
    heading = 2.0 * np.arctan2(np.abs(z), np.abs(w))
    inclination = 2.0 * np.arccos(np.clip(np.sqrt(w * w + z * z), 0.0, 1.0))
    return np.degrees(total), np.degrees(heading), np.degrees(inclination)


def score(trial: Trial, estimate: Array) -> Score:
    """RMS over the rows that count."""
    rows = trial.scored
    parts = errors_deg(estimate[rows], trial.q_enu_sensor[rows])
    return Score(*(float(np.sqrt(np.mean(part**2))) for part in parts))


def constant_turn(trial: Trial, estimate: Array) -> Array:
    """Quaternion that turns the estimates so that their mean heading error vanishes."""
    w, _, _, z = multiply(estimate, conjugate(trial.q_enu_sensor))[trial.scored].T
    error = 2.0 * np.arctan2(z, w)
    half = 0.5 * np.arctan2(np.sin(error).mean(), np.cos(error).mean())
    return np.array([np.cos(half), 0.0, 0.0, -np.sin(half)])


def first_recovery(trial: Trial, estimate: Array, first_row: int) -> int | None:
    """Row, counted from ``first_row``, at which the total error is first under 5 degrees."""
    rows = slice(first_row, first_row + len(estimate))
    total = errors_deg(estimate, trial.q_enu_sensor[rows])[0]
    hits = np.flatnonzero(total < RECOVERED_DEG)
    return int(hits[0]) if len(hits) else None
