"""Bees, CMA-ES, differential evolution and chance on equal budgets: which tunes best?

    python benchmarks/optimizers.py [--runs 10] [--cycles 125] [--plot FILE]
    python benchmarks/optimizers.py --paper

Several runs of each, from seeds 0, 1, ..., on the paper's signals: J on the noise seeds 100-103,
which are searched on, and on 200-219, judged by the plain kernel; median and quartiles. On logs,
``fuzzbee tune`` itself lets chance search beside the bees. ``--paper`` takes the time of the
paper's scale (N = 100, 300 cycles: 60,100 evaluations of 1,401 steps), on one noise seed and one
core.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Iterator

import numpy as np
from common.report import PLOT, Point, Row, Tables, benchmark, draw, option

from tuning.optimizers import run_search
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import decode, encode, random_positions
from tuning.task import profile_with, values_of

ALGORITHMS = {"abc": "bee colony", "cmaes": "CMA-ES", "de": "differential evolution"}
CHANCE = "random search"
FOOD_SOURCES = 40
PARTS = ("searched on", "held out")


def searched(
    task: PaperTask, algorithm: str, seed: int, cycles: int, sources: int = FOOD_SOURCES
) -> Search:
    """One run."""
    options = SearchOptions(algorithm, sources, cycles, sources * task.space.dimensions, seed)
    search = Search(task.space, options, task.costs)
    run_search(search, encode(task.space, values_of(task.space, task.base)))
    return search


def paper_scale(cycles: int) -> Row:
    """How long the paper's search takes, s of processor; compilation is not timed."""
    task = PaperTask(midpoint_profile(), ("membership",), (100,), (200,))
    searched(task, "abc", 0, 1, 100)
    begin_s = time.process_time()
    search = searched(task, "abc", 0, cycles, 100)
    return {"evaluations": search.evaluations, "seconds": time.process_time() - begin_s}


def by_chance(task: PaperTask, seed: int, cycles: int) -> np.ndarray:
    """The best of as many random positions as the others ask for."""
    generator = np.random.default_rng(seed)
    values = decode(
        task.space, random_positions(task.space, FOOD_SOURCES * (1 + 2 * cycles), generator)
    )
    return np.asarray(values[np.argmin(task.costs(values))])


def runs(task: PaperTask, count: int, cycles: int) -> Iterator[tuple[str, tuple[float, float]]]:
    """Each run's name, and its costs on what was searched on and held out."""
    for seed in range(count):
        for algorithm, name in ALGORITHMS.items():
            values = searched(task, algorithm, seed, cycles).best_values
            yield name, judged(task, values)
        yield CHANCE, judged(task, by_chance(task, seed, cycles))


def judged(task: PaperTask, values: np.ndarray) -> tuple[float, float]:
    scores = task.score(profile_with(task.space, task.base, values))
    return scores.tuning, scores.held_out


def tables(options: Namespace) -> Tables:
    if options.smoke:
        options.runs, options.cycles = 1, 1
    if options.paper:
        return {"the paper's optimisation": [paper_scale(1 if options.smoke else 300)]}
    task = PaperTask(midpoint_profile(), ("membership",), (*range(100, 104),), (*range(200, 220),))
    found = list(runs(task, options.runs, options.cycles))
    before = task.score(task.base)
    rows: list[Row] = [{"by": "before", "searched on": before.tuning, "held out": before.held_out}]
    for name in (*ALGORITHMS.values(), CHANCE):
        costs = np.array([pair for each, pair in found if each == name])
        row: Row = {"by": name}
        for part, column in zip(PARTS, costs.T, strict=True):
            low, row[part], high = np.percentile(column, (25.0, 50.0, 75.0)).tolist()
            row[f"quartiles {part}"] = [low, high]
        rows.append(row)
    if options.plot:
        points = [
            Point(p, name, p, J) for name, pair in found for p, J in zip(PARTS, pair, strict=True)
        ]
        draw(options.plot, points, "cost J")
    return {f"J after {FOOD_SOURCES * (1 + 2 * options.cycles)} evaluations": rows}


main = benchmark(
    __doc__,
    tables,
    PLOT,
    option("--runs", type=int, default=10, help="of each algorithm"),
    option("--cycles", type=int, default=125, help="40 (1 + 2 cycles) evaluations a run"),
    option("--paper", action="store_true", help="the time of the paper's scale"),
)

if __name__ == "__main__":
    sys.exit(main())
