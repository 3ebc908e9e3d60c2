"""What does each choice cost where the paper is silent or was not followed?

    python benchmarks/paper_choices.py

The tables of docs/paper.md, each line one change against the profile ``paper`` as it ships:

* ``shipped``: J with the shipped memberships, on the judging seeds (3000-3039).
* ``long steps``: fixed gains at other rates, with a plain step and with the plain bias.
* ``retuned``: J there after a bee colony has looked for memberships under that change, on the
  tuning seeds (100-107): a change may only need other memberships.

Mean over seeds; ``error`` is the standard error of the mean difference to "as built", paired by
seed. ``--tables`` chooses; all of them take the better part of an hour, shipped half a minute.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator
from typing import Any

import numpy as np
from common import paper_filter
from common.paper_filter import AS_BUILT, Choices, Signals, errors_of, signals_of
from common.paper_laws import TABLE, fixed, fuzzy, tune
from common.recordings import Array
from common.report import Row, Tables, benchmark, names, option

from estimator.filter.alignment import quaternion_from_matrix
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES
from estimator.live.settings import settings_of
from estimator.profile import Profile, load_profile, merge_profile
from tests.paper_noise import PAPER_NOISE, NoiseScale
from tuning.space import MEMBERSHIP

TUNING_SEEDS, JUDGING_SEEDS = range(100, 108), range(3000, 3040)
FOOD_SOURCES, CYCLES = 40, 100
PAPER = load_profile("paper")
# The table's "V" (L, as built) read as VL: a misprint of the other neighbour.
V_AS_VERY_LARGE = np.where(TABLE == 3, 4, TABLE)
# Rows read as the error and columns as its rate.
ROWS_AS_ERROR = np.ascontiguousarray(TABLE.T)
# Changes that other memberships might make up for.
RETUNED = {
    "as built": (AS_BUILT, TABLE),
    "rate: low-passed |de/dt|": (Choices(rate=paper_filter.RECTIFIED), TABLE),
    "rate: |de/dt| as it is": (Choices(rate=paper_filter.UNFILTERED), TABLE),
    "rate: none (0)": (Choices(rate=paper_filter.NO_RATE), TABLE),
    "e from the truth": (Choices(error_is_true=True), TABLE),
    "v3 not normalised": (Choices(cross_is_unit=False), TABLE),
    'table\'s "V" is VL': (AS_BUILT, V_AS_VERY_LARGE),
    "rows are e, columns its rate": (AS_BUILT, ROWS_AS_ERROR),
}
PROFILES: dict[str, dict[str, Any]] = {
    "tau = 0.1 s": {"filter": {"rate_time_constant_s": 0.1}},
    "tau = 1 s": {"filter": {"rate_time_constant_s": 1.0}},
    "without v3": {"confidence": {"cross": 0.0}},
    "gamma = 0.2": {"filter": {"gamma": 0.2}},
    "gamma = 5": {"filter": {"gamma": 5.0}},
    "bias bounded at 0.1 rad/s": {"filter": {"bias_bound_rad_s": 0.1}},
    "always the decay": {"filter": {"euler_step_max_s": 0.0}},
    "no correction at t = 0": {"filter": {"first_step_s": 0.0}},
}
LONG_STEPS = ((100, 100), (50, 20), (50, 100), (20, 50), (10, 20), (2, 20), (1, 100))  # Hz, K


def signals(
    seeds: range, rate_hz: float = COST_RATE_HZ, noise: NoiseScale | None = None
) -> Signals:
    """The 15 s of the paper's experiment."""
    samples = round((COST_SAMPLES - 1) * rate_hz / COST_RATE_HZ) + 1
    return signals_of(seeds, samples, noise or PAPER_NOISE, rate_hz)


def run(
    on: Signals,
    choices: Choices = AS_BUILT,
    rules: Array = TABLE,
    *,
    k: Array | None = None,
    profile: Profile = PAPER,
    start: Array | None = None,
    gain: float | None = None,
) -> Array:
    """J (C, S) of memberships (C, 22), or (S,) of the profile's own or of a fixed gain."""
    own = np.array([profile.k]) if k is None else k
    law = fuzzy(own, rules) if gain is None else fixed(np.array([gain]))
    e = errors_of(settings_of(profile), on, law, choices, start, len(own))
    costs = paper_filter.cost(e, on.rate_hz)
    return costs if k is not None else costs[0]


def line(name: str, costs: Array, base: Array) -> Row:
    """Mean J and its difference to ``base`` with the standard error, paired by seed."""
    difference = costs - base
    error = difference.std(ddof=1) / np.sqrt(len(difference)) if len(difference) > 1 else None
    return {
        "change": name,
        "J": float(costs.mean()),
        "difference": float(difference.mean()),
        "error": error,
    }


def shipped_table(options: Namespace) -> list[Row]:
    on = signals(options.judging)
    given = quaternion_from_matrix(np.array(PAPER.filter.initial_attitude))
    variances = NoiseScale(0.2**-0.5, 0.05**-0.5)  # 0.2 and 0.05 as squares
    runs = {name: run(on, *changed) for name, changed in RETUNED.items()}
    runs["e not clipped"] = run(on, Choices(error_is_clipped=False))
    for name, change in PROFILES.items():
        runs[name] = run(on, profile=merge_profile(PAPER, change))
    runs["R_hat(0) not projected"] = run(on, start=paper_filter.matrices(np.array(given)))
    runs["0.2 and 0.05 are variances"] = run(signals(options.judging, noise=variances))
    return [line(name, costs, runs["as built"]) for name, costs in runs.items()]


def long_steps_table(options: Namespace) -> Iterator[Row]:
    """J with e by time; what is built stands beside."""
    plain, by_step = Choices(step_is_plain=True, bias_by_step=True), Choices(bias_by_step=True)
    ways = {"as built": AS_BUILT, "with K dt": plain, "with bias by dt": by_step}
    for rate_hz, gain in LONG_STEPS[:2] if options.smoke else LONG_STEPS:
        on = signals(options.judging, rate_hz)
        row: Row = {"Hz": rate_hz, "K": gain}
        for name, choices in ways.items():
            row[f"J {name}"] = float(run(on, choices, gain=gain).mean())
        yield row


def retuned_table(options: Namespace) -> Iterator[Row]:
    tuning, judging, base = signals(options.tuning), signals(options.judging), None
    for name, (choices, rules) in list(RETUNED.items())[: 1 if options.smoke else None]:
        print(f"retuning: {name} ...", file=sys.stderr, flush=True)

        def costs(k: Array, choices: Choices = choices, rules: Array = rules) -> Array:
            return np.asarray(run(tuning, choices, rules, k=k).mean(axis=1))

        best, _ = tune(MEMBERSHIP, costs, FOOD_SOURCES, options.cycles)
        found = run(judging, choices, rules, k=best[None])[0]
        base = found if base is None else base
        yield line(name, found, base)


TABLES = {"shipped": shipped_table, "long steps": long_steps_table, "retuned": retuned_table}


@benchmark(option("--tables", default=",".join(TABLES), help="which, with commas between them"))
def main(options: Namespace) -> Tables:
    options.tuning, options.judging, options.cycles = TUNING_SEEDS, JUDGING_SEEDS, CYCLES
    if options.smoke:
        options.tuning, options.judging, options.cycles = TUNING_SEEDS[:1], JUDGING_SEEDS[:1], 1
    paper_filter.require_equal(PAPER, fuzzy(np.array(PAPER.k)))
    return {name: [*TABLES[name](options)] for name in names(TABLES, options.tables)}
