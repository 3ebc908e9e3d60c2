"""How long until an attitude is found again after a turn that no sensor has felt?

    python benchmarks/turns.py DIR [DIR ...] [--times 15,40,70] [--angles 20,30,60,179] [--no-field]

Every attitude of a filter is turned about an axis of ENU, either way, without a reading. Seconds
until the total error is first under 5 deg, within 25 s, where it stays under 4 deg without the turn
(95th percentile): median (worst) by axis, then all axes' median, 95th percentile, and how many took
longer than 8 s or were never found. ``aware`` is the share of the errors over 5 deg, from 2 s after
the turn on, that lie under two sigmas. Recordings with a disturbance are left out. Without the
field it is the inclination's error, after turns about level axes.
"""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import NamedTuple

import numpy as np
from common.filters import Filter, chosen_filters
from common.recordings import Array, Trial, chosen_sets
from common.report import FOLDERS, MISSING, Row, Tables, benchmark, numbers, option
from common.scores import by, errors_deg

AXES_ENU = {"z": (0, 0, 1), "x": (1, 0, 0), "y": (0, 1, 0), "diagonal": (1, 1, 1)}
RECOVERED_DEG, MOST_ALONE_DEG = 5.0, 4.0
WITHIN_S, LONG_S, LATE_S = 25.0, 8.0, 2.0
LEAST_LATE = 20  # errors that make a share
# A turn is in motion, or at rest, if this share of the next seconds is.
WHERE_S, WHERE_SHARE = 5.0, 0.8


class Found(NamedTuple):
    """After one turn."""

    where: str  # "motion", "rest" or "mixed"
    angle_deg: float
    axis: str
    time_s: float  # infinite if not within the time
    aware: float  # nan if few errors last


def where_of(trial: Trial, row: int) -> str:
    """What the vehicle does in the seconds behind the row."""
    share = trial.moving[row : row + round(WHERE_S * trial.rate_hz)].mean()
    if share > WHERE_SHARE:
        return "motion"
    return "rest" if share < 1.0 - WHERE_SHARE else "mixed"


def after_turn(
    filter_: Filter, trial: Trial, rows: slice, turn: Array | None
) -> tuple[Array, Array | None]:
    """Errors (N,) of the rows, and their sigmas, from a turn before them on.

    Without a field the inclination's, with one the total ones.
    """
    run = filter_(trial)
    run.advance(slice(0, rows.start))
    if turn is not None:
        run.turn(turn)
    q, sigma = run.advance(rows)
    errors = errors_deg(q, trial.q_enu_sensor[rows])
    if trial.has_mag:
        return errors[:, 0], None if sigma is None else np.hypot(*sigma.T)
    return errors[:, 2], None if sigma is None else sigma[:, 0]


def judge(
    filter_: Filter, trial: Trial, times_s: Sequence[float], angles: Sequence[float]
) -> Iterator[Found]:
    """Every turn at every time."""
    for time_s in times_s:
        row = round(time_s * trial.rate_hz) + 1
        rows = slice(row, row + int(WITHIN_S * trial.rate_hz))
        if rows.stop > len(trial.moving):
            continue
        alone, _ = after_turn(filter_, trial, rows, None)
        if np.isnan(alone).mean() > 0.1 or np.nanquantile(alone, 0.95) > MOST_ALONE_DEG:
            continue
        where = where_of(trial, row)
        for angle in angles:
            for axis, vector in AXES_ENU.items():
                if vector[2] and not trial.has_mag:
                    continue
                for half in (np.radians(angle) / 2.0, -np.radians(angle) / 2.0):
                    along = np.sin(half) * np.array(vector) / np.linalg.norm(vector)
                    turn = np.array([np.cos(half), *along])
                    found = recovery(trial, *after_turn(filter_, trial, rows, turn))
                    yield Found(where, angle, axis, *found)


def recovery(trial: Trial, total: Array, sigma: Array | None) -> tuple[float, float]:
    """Time until recovery, and the share of lasting errors that sigma knew of."""
    hits = np.flatnonzero(total < RECOVERED_DEG)
    time_s = (hits[0] + 1) * trial.dt_s if len(hits) else np.inf
    late = (total > RECOVERED_DEG) & (np.arange(len(total)) >= LATE_S * trial.rate_hz)
    if sigma is None or late.sum() <= LEAST_LATE:
        return time_s, np.nan
    return time_s, float(np.mean(total[late] <= 2.0 * sigma[late]))


def summary(found: Sequence[Found]) -> Row:
    """A line of the table."""
    row: Row = {"n": len(found)}
    for axis in AXES_ENU:
        times = [f.time_s for f in found if f.axis == axis]
        row[axis] = f"{seconds(median(times))} ({seconds(max(times))})" if times else None
    times = [f.time_s for f in found]
    row["median s"] = seconds(median(times))
    row["p95 s"] = seconds(float(np.percentile(np.minimum(times, WITHIN_S), 95)))
    row[f"> {LONG_S:g} s"] = int(np.greater(times, LONG_S).sum())
    row["never"] = int(np.isinf(times).sum())
    aware = [f.aware for f in found if f.aware == f.aware]
    return {**row, "aware": float(np.mean(aware)) if aware else None}


def seconds(value: float) -> str:
    return "never" if value == np.inf else f"{value:.1f}"


@benchmark(
    *FOLDERS,
    option("--filters", default="fuzzbee,vqf", help="names, peers, acausal or gains"),
    option("--times", type=numbers, default=(15.0, 40.0, 70.0), metavar="S,S"),
    option("--angles", type=numbers, default=(20.0, 30.0, 60.0, 179.0), metavar="DEG,DEG"),
    option("--no-field", action="store_true", help="leave out the magnetometer"),
)
def main(options: Namespace) -> Tables:
    options.undisturbed = True
    if options.smoke:
        options.times, options.angles = (20.0,), (60.0,)
    trials = [trial for some in chosen_sets(options).values() for trial in some]
    if options.no_field:
        trials = [replace(trial, mag_ut=np.full_like(trial.mag_ut, np.nan)) for trial in trials]
    table: list[Row] = []
    for name, filter_ in chosen_filters(options.filters):
        if filter_ is None:
            table.append({"filter": name, "n": MISSING})
            continue
        found = [f for t in trials for f in judge(filter_, t, options.times, options.angles)]
        groups = by(found, lambda f: (f.where, f.angle_deg))
        for (where, angle), some in sorted(groups.items(), reverse=True):
            table.append({"filter": name, "where": where, "deg": angle, **summary(some)})
    return {"seconds until the total error is under 5 deg: median (worst)": table}
