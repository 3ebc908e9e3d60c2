"""What is the fuzzy gain good for, against simpler gains and against Kalman filters?

    python benchmarks/gains.py [--seeds 5000-5039] [--mixes 1x1,5x1] [--only profiles] [--plot FILE]

Every way to set the gain is tuned by the same bee colony with one budget, on the noise seeds
100-107 at the paper's noise, and scored on others at times the noise of the gyroscope x of the
vectors: J, mean e over 4..14 s and over 30..60 s, median time to e < 0.01 (s). The profiles are
scored as they ship. ``best fixed K there`` is chosen in hindsight of sixteen, for that noise on
those seeds, column by column; ``ratio early`` and ``ratio late`` are over its e. ``--mixes wide``
has half to ten times either noise and both; ``--only profiles`` tunes nothing.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from common.mekf import FILTERS, mekf_errors
from common.paper_filter import Signals, cost, errors_of, kernel_errors, require_equal, signals_of
from common.paper_laws import KINDS, fuzzy, tune
from common.recordings import Array
from common.report import PLOT, Point, Row, Tables, benchmark, draw, option, seeds

from estimator.geometry.metrics import STEADY
from estimator.live.settings import Settings, settings_of
from estimator.profile import load_profile
from tests.paper_noise import NoiseScale
from tuning.paper_experiment import SETTLED_ERROR

TUNING_SEEDS = range(100, 108)
FOOD_SOURCES, CYCLES = 20, 50
SAMPLES, LATE = 6_001, slice(3_000, 6_001)
MIXES = "1x1,1x2,1x5,2x1,5x1"
WIDE = "0.5x0.5,0.5x1,1x0.5,1x1,1x2,2x1,2x2,1x3,3x1,3x3,1x5,5x1,5x5,1x10,10x1,10x10"
FIXED_GAINS = (0.5, 0.7, 1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70, 100)
BEST = "best fixed K there"
PAPER = load_profile("paper")


def law_errors(name: str, values: Array, settings: Settings, on: Signals) -> Array:
    """The true e (C, S, N) of candidates (C, D)."""
    if name in FILTERS:
        return mekf_errors(settings, on, values)
    return errors_of(settings, on, KINDS[name][0](values), candidates=len(values))


def figures(e: Array, rate_hz: float) -> Row:
    """What is reported of e (S, N)."""
    below = e < SETTLED_ERROR
    settled = np.where(below.any(axis=1), below.argmax(axis=1) / rate_hz, np.inf)
    return {
        "J": float(cost(e).mean()),
        "e 4..14 s": float(e[:, STEADY].mean()),
        "e 30..60 s": float(e[:, LATE].mean()),
        "settled s": float(np.median(settled)),
    }


def score(tuned: Mapping[str, Array], on: Signals) -> Iterator[Row]:
    """Every contender on the signals."""
    settings = settings_of(PAPER)
    fixed = [figures(kernel_errors(settings_of(PAPER, K), on), on.rate_hz) for K in FIXED_GAINS]
    best = {column: min(row[column] for row in fixed) for column in fixed[0]}
    chosen = {column: FIXED_GAINS[int(np.argmin([r[column] for r in fixed]))] for column in best}
    yield {"gain": BEST, **best, "K": [float(K) for K in chosen.values()]}
    found = {
        name: law_errors(name, values[None], settings, on)[0] for name, values in tuned.items()
    }
    for name in ("paper", "adaptive"):
        found[f"profile {name}"] = kernel_errors(settings_of(load_profile(name)), on)
    for name, e in found.items():
        row = {"gain": name, **figures(e, on.rate_hz)}
        row["ratio early"] = row["e 4..14 s"] / best["e 4..14 s"]
        row["ratio late"] = row["e 30..60 s"] / best["e 30..60 s"]
        yield row


def tuned_contenders(options: Namespace) -> tuple[dict[str, Array], list[Row]]:
    """Parameters by name, and the table of them."""
    settings, tuned, rows = settings_of(PAPER), {}, []
    on = signals_of(TUNING_SEEDS[:1] if options.smoke else TUNING_SEEDS, STEADY.stop)
    spaces = {**{name: space for name, (_, space) in KINDS.items()}, **FILTERS}
    most = 0 if options.only == "profiles" else 1 if options.smoke else None
    for name, space in list(spaces.items())[:most]:
        print(f"tuning: {name} ...", file=sys.stderr, flush=True)

        def evaluate(values: Array, name: str = name) -> Array:
            return np.asarray(cost(law_errors(name, values, settings, on)).mean(axis=1))

        tuned[name], least = tune(space, evaluate, FOOD_SOURCES, options.cycles)
        values = dict(zip((p.name for p in space), tuned[name].tolist(), strict=True))
        rows.append({"gain": name, "J there": least, "parameters": values})
    return tuned, rows


def points(tables: Mapping[str, Sequence[Row]]) -> list[Point]:
    """e and settling over those of the best fixed gain, by noise."""
    return [
        Point(column, row["gain"], mix, row[column] / rows[0][column])
        for column in ("e 4..14 s", "e 30..60 s", "settled s")
        for mix, rows in tables.items()
        for row in rows[1:]
    ]


@benchmark(
    PLOT,
    option("--seeds", type=seeds, default=range(5000, 5040), help="that are scored on"),
    option("--mixes", default=MIXES, help="GxV: times gyroscope's x vectors', or wide"),
    option("--cycles", type=int, default=CYCLES, help="20 (1 + 2 cycles) evaluations each"),
    option("--only", choices=("profiles",), help="tune nothing"),
)
def main(options: Namespace) -> Tables:
    if options.smoke:
        options.seeds, options.mixes, options.cycles = options.seeds[:1], "1x1", 1
    require_equal(PAPER, fuzzy(np.array(PAPER.k)))
    tuned, parameters = tuned_contenders(options)
    mixes = {}
    for mix in (WIDE if options.mixes == "wide" else options.mixes).split(","):
        gyroscope, vectors = map(float, mix.split("x"))
        on = signals_of(options.seeds, SAMPLES, NoiseScale(gyroscope, vectors))
        mixes[f"gyroscope's noise x{gyroscope:g}, vectors' x{vectors:g}"] = [*score(tuned, on)]
    if options.plot is not None:
        draw(options.plot, points(mixes), "over the best fixed K's", is_log=True)
    tuned_on = {"tuned on the seeds 100-107": parameters} if parameters else {}
    return {**tuned_on, **mixes}
