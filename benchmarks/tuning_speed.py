"""How long does the paper's optimisation take, and how does that compare with other ways to do it?

    python benchmarks/tuning_speed.py

All in one run and one process, compilation not timed; processor time, of a step the best of
repetitions, the one that other programs disturbed least. ``the search``: the paper's scale (N =
100, 300 cycles: 60,100 evaluations of 1,401 steps), one noise seed. ``a step``: inference included.
pygmo's bee_colony calls the same compiled objective one candidate at a time: its seconds an
evaluation over ours, which asks for the whole colony at once.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from common.report import MISSING, Row, parser, show

from tuning.optimizers import run_search
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import bounds, decode, encode, make_feasible, random_positions
from tuning.task import values_of

CANDIDATES, STEPS = 96, 1401
SEED = 1


def search_once(task: PaperTask, cycles: int) -> tuple[float, int]:
    """One search; its seconds of processor and evaluations."""
    options = SearchOptions("abc", 100, cycles, 2200, 0)
    search = Search(task.space, options, task.costs)
    started = time.process_time()
    run_search(search, encode(task.space, values_of(task.space, task.base)))
    return time.process_time() - started, search.evaluations


def best_s(function: Callable[[], object], repetitions: int) -> float:
    """Processor time of the quickest call after a first one, which compiles."""
    times = []
    function()
    for _ in range(repetitions):
        started = time.process_time()
        function()
        times.append(time.process_time() - started)
    return min(times)


def steps(task: PaperTask, candidates: int) -> Callable[[], object]:
    """A search's evaluations on one core."""
    values = some_values(task, candidates)
    return lambda: task.costs(values)


def some_values(task: PaperTask, count: int):
    generator = np.random.default_rng(SEED)
    return decode(task.space, random_positions(task.space, count, generator))


class PygmoProblem:
    """The same objective as pygmo wants it: one candidate a call."""

    def __init__(self, task: PaperTask) -> None:
        self.task = task

    def fitness(self, x):  # noqa: D102 - pygmo's name
        position = make_feasible(self.task.space, np.asarray(x)[None, :])
        return [float(self.task.costs(decode(self.task.space, position))[0])]

    def get_bounds(self):  # noqa: D102 - pygmo's name
        lower, upper = bounds(self.task.space)
        return lower.tolist(), upper.tolist()


def pygmo_s(task: PaperTask, generations: int) -> float | None:
    """Seconds an evaluation; None without pygmo."""
    try:
        import pygmo
    except ImportError:
        return None
    problem = pygmo.problem(PygmoProblem(task))
    population = pygmo.population(problem, size=100, seed=SEED)
    algorithm = pygmo.algorithm(pygmo.bee_colony(gen=generations, limit=2200, seed=SEED))
    before = population.problem.get_fevals()
    started = time.process_time()
    population = algorithm.evolve(population)
    return (time.process_time() - started) / (population.problem.get_fevals() - before)


def measure(cycles: int, repetitions: int) -> list[Row]:
    task = PaperTask(midpoint_profile(), ("membership",), (100,), (200,))
    search_once(task, 1)
    seconds, evaluations = search_once(task, cycles)
    step_s = best_s(steps(task, CANDIDATES), repetitions) / (CANDIDATES * STEPS)
    ours_s, other_s = seconds / evaluations, pygmo_s(task, max(1, cycles // 60))
    other = MISSING if other_s is None else other_s
    return [
        {"what": f"the search, {evaluations} evaluations", "seconds": seconds},
        {"what": "a step of the search", "seconds": step_s},
        {"what": "an evaluation of the search", "seconds": ours_s, "ratio": 1.0},
        {
            "what": "an evaluation by pygmo's bee_colony",
            "seconds": other,
            "ratio": None if other_s is None else other_s / ours_s,
        },
    ]


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--cycles", type=int, default=300, help="300: the paper's scale")
    options = made.parse_args()
    scale = (2, 1) if options.smoke else (options.cycles, 7)
    show({"the paper's optimisation": measure(*scale)}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
