"""How long does the paper's optimisation take, and how does that compare with other ways to do it?

    python benchmarks/tuning_speed.py

All in one run, compilation not timed; best of repetitions, the one that other programs disturbed
least. ``the search``: the paper's scale (N = 100, 300 cycles: 60,100 evaluations of 1,401 steps),
one noise seed, on all cores, seconds. ``a step`` of the search's kernel, inference included, on
one core; beside it, as ratios over it: a step of the filter's own kernel, one inference by
scikit-fuzzy's control system (101-point universes, cache off, built once), and one by its plain
functions on the exact universe of ``estimator/filter/fuzzy_reference.py``. pygmo's bee_colony calls
the same compiled objective one candidate at a time: its seconds an evaluation over ours, which
asks for the whole colony at once.
"""

import os
import sys
import time
from collections.abc import Callable

import numpy as np
from common.paper_filter import simulate_scaled
from common.report import MISSING, Row, parser, show

from estimator.filter import fuzzy_reference, kernel, memberships
from estimator.filter.fuzzy import RULES, fuzzy_gain
from estimator.filter.types import initial_state
from estimator.live.settings import settings_of
from tuning.objective import profile_with, values_of
from tuning.optimizers import run_search
from tuning.paper_noise import NoiseScale
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import bounds, decode, encode, make_feasible, random_positions

CANDIDATES, PLAIN_CANDIDATES, STEPS = 96, 20, 1401
GRID_POINTS = 101
SEED = 1


def search_once(task: PaperTask, cycles: int) -> tuple[float, int]:
    """One search; its seconds and evaluations."""
    options = SearchOptions("abc", 100, cycles, 2200, 0)
    search = Search(task.space, options, task.objective.costs)
    started = time.perf_counter()
    run_search(search, encode(task.space, values_of(task.space, task.base)))
    return time.perf_counter() - started, search.evaluations


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
    """The search's kernel on one core."""
    values = some_values(task, candidates)
    return lambda: task.objective.serial_costs(values)


def plain_steps(task: PaperTask, candidates: int) -> Callable[[], object]:
    """The same steps by the filter's own kernel, candidate after candidate."""
    values = some_values(task, candidates)
    chosen = [settings_of(profile_with(task.space, task.base, one)) for one in values]
    signals = simulate_scaled(task.noise_seeds[0], STEPS, NoiseScale())
    readings = (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss)

    def run() -> None:
        for own in chosen:
            start = initial_state(own.initial)
            kernel.run(own.filter, own.reference, start, *readings, 0.01)

    return run


def some_values(task: PaperTask, count: int):
    generator = np.random.default_rng(SEED)
    return decode(task.space, random_positions(task.space, count, generator))


def control_system(k: memberships.Memberships):
    """The controller in scikit-fuzzy's control API, with the 25 rules."""
    from skfuzzy import control, trimf

    sets = memberships.fuzzy_sets(k)
    unit = np.linspace(0.0, 1.0, GRID_POINTS)
    error, rate = control.Antecedent(unit, "error"), control.Antecedent(unit, "rate")
    gain = control.Consequent(100.0 * unit, "gain")
    for variable, triangles in ((error, sets.inputs), (rate, sets.inputs), (gain, sets.output)):
        for term, corners in zip(memberships.TERMS, triangles, strict=True):
            variable[term] = trimf(variable.universe, np.array(corners))
    terms = memberships.TERMS
    rules = [
        control.Rule(rate[terms[row]] & error[terms[column]], gain[terms[consequent]])
        for row, consequents in enumerate(RULES)
        for column, consequent in enumerate(consequents)
    ]
    return control.ControlSystemSimulation(control.ControlSystem(rules), cache=False)


def compute(simulation, error: float, rate: float) -> float:
    simulation.input["error"], simulation.input["rate"] = error, rate
    simulation.compute()
    return float(simulation.output["gain"])


def inputs(k: memberships.Memberships, count: int) -> list[tuple[float, float]]:
    """Errors and rates where a rule fires: elsewhere the control system has no output."""
    generator, found = np.random.default_rng(SEED), []
    while len(found) < count:
        e, d = generator.random(2).tolist()
        if fuzzy_gain(k, e, d) > 0.0:
            found.append((e, d))
    return found


class PygmoProblem:
    """The same objective as pygmo wants it: one candidate a call."""

    def __init__(self, task: PaperTask) -> None:
        self.task = task

    def fitness(self, x):  # noqa: D102 - pygmo's name
        position = make_feasible(self.task.space, np.asarray(x)[None, :])
        return [float(self.task.objective.serial_costs(decode(self.task.space, position))[0])]

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
    started = time.perf_counter()
    population = algorithm.evolve(population)
    return (time.perf_counter() - started) / (population.problem.get_fevals() - before)


def measure(cycles: int, repetitions: int, calls: int) -> list[Row]:
    task = PaperTask(midpoint_profile(), ("membership",), (100,), (200,))
    search_once(task, 1)
    seconds, evaluations = search_once(task, cycles)
    step_s = best_s(steps(task, CANDIDATES), repetitions) / (CANDIDATES * STEPS)
    plain_s = best_s(plain_steps(task, PLAIN_CANDIDATES), repetitions) / (PLAIN_CANDIDATES * STEPS)
    k, few = memberships.midpoint(), inputs(memberships.midpoint(), calls)
    system = control_system(k)
    control_s = best_s(lambda: [compute(system, *pair) for pair in few], repetitions) / calls
    exact_s = best_s(lambda: [fuzzy_reference.gain(k, *p) for p in few], repetitions) / calls
    other_s = pygmo_s(task, max(1, cycles // 60))
    ours_s = seconds / evaluations
    return [
        {"what": f"the search, {evaluations} evaluations", "seconds": seconds},
        {"what": "a step", "seconds": step_s, "over a step": 1.0},
        {
            "what": "a step of the filter's own kernel",
            "seconds": plain_s,
            "over a step": plain_s / step_s,
        },
        {"what": "a step, over the own kernel's", "over a step": step_s / plain_s},
        {
            "what": "scikit-fuzzy's control system",
            "seconds": control_s,
            "over a step": control_s / step_s,
        },
        {
            "what": "scikit-fuzzy's functions, exact",
            "seconds": exact_s,
            "over a step": exact_s / step_s,
        },
        {"what": "an evaluation of the search", "seconds": ours_s, "over ours": 1.0},
        {
            "what": "pygmo's bee_colony, an evaluation",
            "seconds": other_s,
            "over ours": MISSING if other_s is None else other_s / ours_s,
        },
    ]


def main() -> int:
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command has it
    made = parser(__doc__)
    made.add_argument("--cycles", type=int, default=300, help="300: the paper's scale")
    options = made.parse_args()
    scale = (2, 1, 3) if options.smoke else (options.cycles, 7, 100)
    show({"the paper's optimisation": measure(*scale)}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
