"""One set of scores: errors in BROAD's protocol, and what sigma knew of them."""

from collections.abc import Callable, Iterable, Sequence
from statistics import fmean

import numpy as np
from common.recordings import Array, Bools, Trial
from common.report import Row

from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import about_down, conjugate, heading_of, multiply

SETTLED_S = 5.0  # sigma counts from then on
LEAST_ROWS = 50
BOOTSTRAP_DRAWS = 10_000


def errors_deg(estimate: Array, truth: Array) -> Array:
    """Total, heading and inclination error (N, 3) of attitudes (N, 4), z of the earth vertical."""
    pair = (np.ascontiguousarray(estimate), np.ascontiguousarray(truth))
    return np.asarray(np.degrees(batch_angle_errors(*pair)))


def rms(values: Array) -> list[float]:
    """Root mean square of each column."""
    root: list[float] = np.sqrt(np.mean(np.square(values), axis=0)).tolist()
    return root


def covered(errors: Array, sigmas: Array) -> list[float] | None:
    """Shares of the errors of inclination and heading under sigma (N, 2); None of few rows."""
    if len(errors) < LEAST_ROWS:
        return None
    share: list[float] = np.mean(errors[:, [2, 1]] <= sigmas, axis=0).tolist()
    return share


def heading_free(estimate: Array, truth: Array, rows: Bools) -> Array:
    """The estimates turned about the vertical so that their mean heading error vanishes."""
    error = heading_of(multiply(estimate, conjugate(truth))[rows])
    mean = np.arctan2(np.sin(error).mean(), np.cos(error).mean())
    return multiply(about_down(np.array([-mean])), estimate)


def score(trial: Trial, q: Array, sigma_deg: Array | None) -> Row:
    """RMS errors in degrees over the rows that count, coverage in motion and at rest."""
    truth, rows = trial.q_enu_sensor, trial.scored
    errors = errors_deg(q, truth)
    total, heading, inclination = rms(errors[rows])
    free = errors_deg(heading_free(q, truth, rows)[rows], truth[rows])
    row: Row = {"total": total, "heading": heading, "inclination": inclination}
    row["free"] = rms(free)[0]
    if sigma_deg is not None:
        known = ~np.isnan(truth).any(axis=1) & (trial.times_s > SETTLED_S)
        for name, which in (("in motion", trial.moving), ("at rest", ~trial.moving)):
            row[f"under sigma {name}"] = covered(errors[known & which], sigma_deg[known & which])
    return row


def mean_of(rows: Sequence[Row], of: Callable[[Iterable[float]], float] = fmean) -> Row:
    """Column by column over the rows that have one, numbers and lists of them."""
    means: Row = {}
    for name in rows[0]:
        values = [row[name] for row in rows if row[name] is not None]
        if not values:
            means[name] = None
        elif isinstance(values[0], list):
            means[name] = [of(column) for column in zip(*values, strict=True)]
        else:
            means[name] = of(values)
    return means


def change(values: Sequence[float], base: Sequence[float]) -> list[float]:
    """Mean difference of pairs, and 95 % of the means of pairs drawn with replacement."""
    differences = np.subtract(values, base)
    draws = np.random.default_rng(0).choice(differences, (BOOTSTRAP_DRAWS, len(differences)))
    low, high = np.percentile(draws.mean(axis=1), [2.5, 97.5])
    return [float(differences.mean()), float(low), float(high)]


def by(rows: Sequence[Row], key: Callable[[Row], object]) -> dict[object, list[Row]]:
    """The rows in groups, in the order in which groups come."""
    groups: dict[object, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups
