"""How accurate are fuzzbee, its variants and other filters on recordings with optical truth?

    python benchmarks/accuracy.py DIR [DIR ...] [--filters peers] [--ways all] [--plot FILE]

A row a folder, way of recording and filter: RMS errors in motion in degrees (BROAD's protocol),
mean over the recordings; ``free`` is the total with a constant heading per recording taken off,
``worst`` the largest total. ``under sigma`` is the share of errors of inclination and heading under
the published sigma (0.68 is honest). ``change`` is the mean change of the total against the first
filter, by recording, with its bootstrapped 95 % interval.

Filters are names with commas between them, ``peers``, ``acausal`` or ``gains`` (the profile imu
with other gains). Ways are those of common/ways.py, or ``all``.
"""

from argparse import Namespace
from collections.abc import Sequence

import numpy as np
from common.filters import chosen_filters, run_whole
from common.recordings import Trial, chosen_sets
from common.report import FOLDERS, MISSING, PLOT, Point, Row, Tables, benchmark, draw, option
from common.scores import change, mean_of, score
from common.ways import WAYS


def worse(trials: Sequence[Trial], way: str, seed: int) -> list[Trial]:
    """The recordings in that way, each from a seed of its own."""
    rngs = [np.random.default_rng([seed, k, len(way)]) for k in range(len(trials))]
    found = [WAYS[way](trial, rng) for trial, rng in zip(trials, rngs, strict=True)]
    return [t for each in found for t in (each if isinstance(each, list) else [each])]


def summary(rows: Sequence[Row], base: Sequence[Row]) -> Row:
    """Means over the recordings."""
    totals = [row["total"] for row in rows]
    found = {"n": len(rows), **mean_of(rows), "worst": max(totals)}
    return {**found, "change": change(totals, [row["total"] for row in base])}


@benchmark(
    *FOLDERS,
    PLOT,
    option("--filters", default="peers", help="names, peers, acausal or gains"),
    option("--ways", nargs="+", choices=[*WAYS, "all"], default=["as recorded"]),
    option("--seed", type=int, default=0),
)
def main(options: Namespace) -> Tables:
    table: list[Row] = []
    points: list[Point] = []
    for folder, trials in chosen_sets(options).items():
        for way in list(WAYS) if options.ways == ["all"] else options.ways:
            made, base = worse(trials, way, options.seed), None
            for name, filter_ in chosen_filters(options.filters):
                head = {"set": folder, "way": way, "filter": name}
                if filter_ is None:
                    table.append({**head, "n": MISSING})
                    continue
                rows = [score(trial, *run_whole(filter_, trial)) for trial in made]
                base = rows if base is None else base
                table.append({**head, **summary(rows, base)})
                panel, pairs = f"{folder}, {way}", zip(made, rows, strict=True)
                points += [Point(panel, trial.name, name, row["total"]) for trial, row in pairs]
    if options.plot:
        draw(options.plot, points, "total RMS error, degrees", is_log=True)
    return {"accuracy, degrees": table}
