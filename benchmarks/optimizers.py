"""Bees, CMA-ES and differential evolution on equal budgets: cost on data the search never saw.

Several runs of each, from seeds 0, 1, ..., on the paper's signals (noise seeds 100-103, judged on
200-219 by the plain kernel). Prints median and quartiles; ``--plot FILE`` draws every run.
On logs, ``fuzzbee tune`` itself lets chance search beside the bees.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tuning.objective import profile_with, values_of
from tuning.optimizers import run_search
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import encode

NAMES = {"abc": "bee colony", "cmaes": "CMA-ES", "de": "differential evolution"}
FOOD_SOURCES = 40


def paper_task():
    return PaperTask(
        midpoint_profile(), ("membership",), tuple(range(100, 104)), tuple(range(200, 220))
    )


def one_run(task, algorithm, seed, cycles):
    limit = FOOD_SOURCES * task.space.dimensions
    options = SearchOptions(algorithm, FOOD_SOURCES, cycles, limit, seed)
    search = Search(task.space, options, task.objective.costs)
    run_search(search, encode(task.space, values_of(task.space, task.base)))
    scores = task.score(profile_with(task.space, task.base, search.best_values))
    return {"evaluations": search.evaluations, "tuning": scores.tuning, "held_out": scores.held_out}


def compare(task, runs, cycles):
    base = task.score(task.base)
    results = {}
    for algorithm in NAMES:
        started = time.perf_counter()
        each = [one_run(task, algorithm, seed, cycles) for seed in range(runs)]
        results[algorithm] = {
            "runs": each,
            "tuning": quartiles([run["tuning"] for run in each]),
            "held_out": quartiles([run["held_out"] for run in each]),
            "seconds": time.perf_counter() - started,
        }
    return {
        "base": {"tuning": base.tuning, "held_out": base.held_out},
        "dimensions": task.space.dimensions,
        "algorithms": results,
    }


def quartiles(values):
    low, middle, high = np.percentile(values, (25.0, 50.0, 75.0)).tolist()
    return {"median": middle, "quartiles": [low, high], "range": [min(values), max(values)]}


def plot(result, path):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * len(result), 4.2), layout="constrained")
    axes = figure.subplots(1, len(result), squeeze=False)[0]
    for ax, (title, part) in zip(axes, result.items(), strict=True):
        for i, found in enumerate(part["algorithms"].values()):
            for offset, key, marker in ((-0.15, "tuning", "o"), (0.15, "held_out", "s")):
                costs = [run[key] for run in found["runs"]]
                spread = np.linspace(-0.08, 0.08, len(costs))
                label = key.replace("_", " ") if i == 0 else None
                colour = "C0" if key == "tuning" else "C1"
                ax.plot(i + offset + spread, costs, marker, color=colour, alpha=0.6, label=label)
                ax.hlines(found[key]["median"], i + offset - 0.12, i + offset + 0.12, color="black")
        ax.set_xticks(range(len(NAMES)), [NAMES[name] for name in part["algorithms"]])
        ax.set(title=title, ylabel="cost J")
        ax.grid(visible=True, axis="y", alpha=0.3)
        ax.legend()
    figure.savefig(path, dpi=150)


def show(result):
    for title, part in result.items():
        print(
            f"{title}: before {part['base']['tuning']:.3f}, held out {part['base']['held_out']:.3f}"
        )
        for name, found in part["algorithms"].items():
            for key in ("tuning", "held_out"):
                low, high = found[key]["quartiles"]
                print(
                    f"  {NAMES[name]:24} {key:9} median {found[key]['median']:8.4f}"
                    f"  quartiles {low:8.4f} .. {high:8.4f}"
                )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object, every run in it")
    parser.add_argument("--runs", type=int, default=10, help="of each algorithm")
    parser.add_argument(
        "--cycles", type=int, default=125, help="40 (1 + 2 cycles) evaluations a run"
    )
    parser.add_argument("--plot", type=Path, help="PNG file")
    options = parser.parse_args()
    result = {"the paper's signals": compare(paper_task(), options.runs, options.cycles)}
    if options.plot is not None:
        plot(result, options.plot)
    if options.json:
        print(json.dumps(result))
    else:
        show(result)


if __name__ == "__main__":
    main()
