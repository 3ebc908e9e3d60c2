"""How long the paper's optimisation takes, and how that compares with other ways to do it.

All in one run, compilation not timed:

* ``seconds``: the paper's scale (N = 100, 300 cycles: 60,100 evaluations of 1,401 steps), one
  noise seed, on all cores.
* ``step_ns``: one filter step with inference inside the search's kernel, on one core.
* ``plain_ratio``: that over a step of the filter's own kernel.
* ``skfuzzy_control_ratio`` and ``skfuzzy_plain_ratio``: one inference by scikit-fuzzy's control
  system (101-point universes, cache off, built once), and one by its plain functions on the exact
  universe of ``estimator/filter/fuzzy_reference.py``, over one whole step of ours.
* ``pygmo_ratio``: pygmo's bee_colony calling the same compiled objective one candidate at a time,
  over ours asking for the whole colony at once, in seconds an evaluation. None without pygmo.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.kernel import compute, control_simulation
from drivers.simulation.simulated_vehicle import simulate
from estimator.filter import fuzzy_reference, kernel, memberships
from estimator.filter.fuzzy import fuzzy_gain
from estimator.filter.types import initial_state
from estimator.live.settings import settings_of
from tuning.objective import profile_with, values_of
from tuning.optimizers import run_search
from tuning.paper_kernel import DT_S
from tuning.paper_signals import SCORED_SAMPLES
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import bounds, decode, encode, make_feasible, random_positions

REPETITIONS = 5
CANDIDATES = 100
PLAIN_CANDIDATES = 20
CONTROL_CALLS = 100
PLAIN_CALLS = 500
PYGMO_GENERATIONS = 5
SEED = 1


def search_once(task, cycles):
    """One search; its seconds and evaluations."""
    options = SearchOptions("abc", 100, cycles, 2200, 0)
    search = Search(task.space, options, task.objective.costs)
    first = encode(task.space, values_of(task.space, task.base))
    started = time.perf_counter()
    run_search(search, first)
    return time.perf_counter() - started, search.evaluations


def best_of(function, repetitions=REPETITIONS):
    """Processor time of the quickest call, the one that other programs disturbed least."""
    times = []
    for _ in range(repetitions):
        started = time.process_time()
        function()
        times.append(time.process_time() - started)
    return min(times)


def step_ns(task):
    values = decode(
        task.space, random_positions(task.space, CANDIDATES, np.random.default_rng(SEED))
    )
    task.objective.serial_costs(values[:2])
    steps = CANDIDATES * len(task.noise_seeds) * SCORED_SAMPLES
    return 1e9 * best_of(lambda: task.objective.serial_costs(values)) / steps


def plain_step_ns(task):
    """The same steps by the filter's own kernel, candidate after candidate."""
    values = decode(
        task.space, random_positions(task.space, PLAIN_CANDIDATES, np.random.default_rng(SEED))
    )
    chosen = [settings_of(profile_with(task.space, task.base, one)) for one in values]
    signals = simulate(task.noise_seeds[0], SCORED_SAMPLES)

    def run_all():
        for settings in chosen:
            kernel.run(
                settings.filter,
                settings.reference,
                initial_state(settings.initial),
                signals.gyr_rad_s,
                signals.acc_m_s2,
                signals.mag_gauss,
                DT_S,
            )

    run_all()
    return 1e9 * best_of(run_all) / (len(chosen) * SCORED_SAMPLES)


def inference_inputs(count):
    """Errors and rates where a rule fires: elsewhere the control system has no output."""
    generator = np.random.default_rng(SEED)
    k = memberships.midpoint()
    found = []
    while len(found) < count:
        e, d = generator.random(2).tolist()
        if fuzzy_gain(k, e, d) > 0.0:
            found.append((e, d))
    return found


def skfuzzy_ns():
    """One inference by the control system, and one by the plain functions."""
    k = memberships.midpoint()
    simulation = control_simulation(k)
    few, many = inference_inputs(CONTROL_CALLS), inference_inputs(PLAIN_CALLS)
    compute(simulation, *few[0])
    control = best_of(lambda: [compute(simulation, *pair) for pair in few], 2) / len(few)
    plain = best_of(lambda: [fuzzy_reference.gain(k, *pair) for pair in many], 2) / len(many)
    return 1e9 * control, 1e9 * plain


class PygmoProblem:
    """The same objective as pygmo wants it: one candidate a call."""

    def __init__(self, task):
        self.task = task

    def fitness(self, x):  # noqa: D102 - pygmo's name
        position = make_feasible(self.task.space, np.asarray(x)[None, :])
        return [float(self.task.objective.serial_costs(decode(self.task.space, position))[0])]

    def get_bounds(self):  # noqa: D102 - likewise
        lower, upper = bounds(self.task.space)
        return lower.tolist(), upper.tolist()


def pygmo_seconds_an_evaluation(task):
    try:
        import pygmo
    except ImportError:
        return None
    problem = pygmo.problem(PygmoProblem(task))
    population = pygmo.population(problem, size=100, seed=SEED)
    algorithm = pygmo.algorithm(pygmo.bee_colony(gen=PYGMO_GENERATIONS, limit=2200, seed=SEED))
    before = population.problem.get_fevals()
    started = time.perf_counter()
    population = algorithm.evolve(population)
    elapsed = time.perf_counter() - started
    return elapsed / (population.problem.get_fevals() - before)


def measure(cycles):
    task = PaperTask(midpoint_profile(), ("membership",), (100,), (200,))
    search_once(task, 1)
    seconds, evaluations = search_once(task, cycles)
    ours_ns = step_ns(task)
    control_ns, plain_ns = skfuzzy_ns()
    pygmo_s = pygmo_seconds_an_evaluation(task)
    return {
        "seconds": seconds,
        "evaluations": evaluations,
        "step_ns": ours_ns,
        "plain_ratio": ours_ns / plain_step_ns(task),
        "skfuzzy_control_ratio": control_ns / ours_ns,
        "skfuzzy_plain_ratio": plain_ns / ours_ns,
        "pygmo_ratio": None if pygmo_s is None else pygmo_s / (seconds / evaluations),
    }


def main():
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command has it
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object")
    parser.add_argument("--cycles", type=int, default=300, help="300: the paper's scale")
    options = parser.parse_args()
    result = measure(options.cycles)
    if options.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:22} {'not installed' if value is None else f'{value:.4g}'}")


if __name__ == "__main__":
    main()
