"""What each choice costs where the paper is silent or was not followed: J with other choices.

The tables of docs/paper.md, each line one change against the profile ``paper`` as it ships:

* ``shipped``: J with the shipped memberships, on the judging seeds.
* ``retuned``: J there after a bee colony has looked for memberships under that change, on the
  tuning seeds: a change may only need other memberships. The profile as built is retuned, too.
* ``colony``: J that the search ends at, on both kinds of seeds, with its own rules changed.

Mean over seeds; the error is the standard error of the mean difference to "as built" on the same
seeds. ``--quick`` makes everything small, to see that it runs.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.paper_variants import (
    AS_BUILT,
    NO_RATE,
    RECTIFIED,
    ROWS_AS_ERROR,
    UNFILTERED,
    V_AS_VERY_LARGE,
    Switches,
    costs_of,
    signals_of,
)
from estimator.filter.alignment import quaternion_from_matrix
from estimator.filter.memberships import midpoint
from estimator.filter.types import initial_state
from estimator.geometry.quaternion import angle_between
from estimator.live.settings import settings_of
from estimator.profile import load_profile, merge_profile
from tuning.colony import Colony
from tuning.paper_experiment import run_experiment
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.space import decode, encode, membership_space

TUNING_SEEDS = range(100, 108)
JUDGING_SEEDS = range(3000, 3040)
FOOD_SOURCES, CYCLES = 40, 100
SEARCH_SEEDS = range(5)
PAPER = load_profile("paper")


def run(signals, switches=Switches(), rules=AS_BUILT, *, profile=PAPER, rate_hz=100.0,  # noqa: B008
        start=None, candidates=None, fixed_gain=None):  # fmt: skip
    """J (C, S) of the candidates, or (S,) of the profile's own memberships."""
    settings = settings_of(profile, fixed_gain)
    first = initial_state(settings.initial if start is None else start)
    own = np.array([profile.k]) if candidates is None else candidates
    costs = costs_of(
        settings.filter, settings.reference, switches, rules, first, signals, rate_hz, own
    )
    return costs[0] if candidates is None else costs


class OtherColony(Colony):
    """The bees with alpha from [0, 1], or with onlookers drawn by J itself, as printed."""

    def __init__(self, space, generator, limit, *, positive, by_cost):
        self._by_cost = by_cost
        draws = PositiveAlpha(generator) if positive else generator
        first = encode(space, np.array([midpoint()]))
        super().__init__(space, FOOD_SOURCES, limit, draws, first)

    def _send_onlookers(self):
        if not self._by_cost:
            super()._send_onlookers()
            return
        self._phase = "onlookers"
        chance = np.cumsum(self.sources.costs) / np.sum(self.sources.costs)
        drawn = self._generator.random(len(chance))
        self._visit(np.minimum(np.searchsorted(chance, drawn, side="right"), len(chance) - 1))


class PositiveAlpha:
    """A generator whose uniform numbers from [-1, 1] are from [0, 1]."""

    def __init__(self, generator):
        self._generator = generator

    def __getattr__(self, name):
        return getattr(self._generator, name)

    def uniform(self, low, high, size):
        """As numpy's, from 0 on."""
        return self._generator.uniform(max(low, 0.0), high, size)


def search_once(costs, cycles, seed=0, *, positive=False, by_cost=False, limit=None):
    """The best memberships (22,) of one search over ``costs(values (C, 22)) -> (C,)``; scouts."""
    space = membership_space()
    colony = OtherColony(space, np.random.default_rng(seed),
                         limit or FOOD_SOURCES * space.dimensions,
                         positive=positive, by_cost=by_cost)  # fmt: skip
    best, best_cost = None, np.inf
    while colony.cycles < cycles:
        asked = colony.ask()
        told = costs(decode(space, asked))
        if told.min() < best_cost:
            best, best_cost = decode(space, asked)[np.argmin(told)], told.min()
        colony.tell(told)
    return best, colony.scouts


def line(name, costs, base):
    """Mean J and its difference to ``base`` with the standard error, paired by seed."""
    difference = costs - base
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    return {"change": name, "J": costs.mean(), "difference": difference.mean(), "error": error}


def shipped_table(signals, seeds):
    base = run(signals)
    same = [run_experiment(PAPER, seed).cost for seed in seeds]
    assert np.allclose(base, same, rtol=1e-9), "the variants' kernel is not the filter"
    raw = np.array(PAPER.filter.initial_attitude)
    unprojected = quaternion_from_matrix(raw)
    turned = np.degrees(angle_between(unprojected, settings_of(PAPER).initial))

    def cost_with(section, **keys):
        return run(signals, profile=merge_profile(PAPER, {section: keys}))

    variance = signals_of(seeds, gyro_noise=0.2**-0.5, vector_noise=0.05**-0.5)
    rows = [
        ("as built", base),
        ("rate: low-passed |de/dt|", run(signals, Switches(rate=RECTIFIED))),
        ("rate: |de/dt| as it is", run(signals, Switches(rate=UNFILTERED))),
        ("rate: none (0)", run(signals, Switches(rate=NO_RATE))),
        ("tau = 0.1 s", cost_with("filter", rate_time_constant_s=0.1)),
        ("tau = 1 s", cost_with("filter", rate_time_constant_s=1.0)),
        ("e from the truth", run(signals, Switches(error_is_true=True))),
        ("e not clipped", run(signals, Switches(error_is_clipped=False))),
        ("v3 not normalised", run(signals, Switches(cross_is_unit=False))),
        ("without v3", cost_with("confidence", cross=0.0)),
        ('table\'s "V" is VL', run(signals, rules=V_AS_VERY_LARGE)),
        ("rows are e, columns its rate", run(signals, rules=ROWS_AS_ERROR)),
        ("gamma = 0.2", cost_with("filter", gamma=0.2)),
        ("gamma = 5", cost_with("filter", gamma=5.0)),
        ("bias bounded at 0.1 rad/s", cost_with("filter", bias_bound_rad_s=0.1)),
        ("always the decay", cost_with("filter", euler_step_max_s=0.0)),
        ("no correction at t = 0", cost_with("filter", first_step_s=0.0)),
        (f"R_hat(0) not projected ({turned:.4f} deg away)", run(signals, start=unprojected)),
        ("0.2 and 0.05 are variances", run(variance)),
    ]
    return [line(name, costs, base) for name, costs in rows]


def long_step_table(seeds):
    """The plain step and the plain bias where steps are long; fixed gains, J with e by time."""
    rows = []
    for rate_hz, gain in (
        (100.0, 100.0),
        (50.0, 20.0),
        (50.0, 100.0),
        (20.0, 50.0),
        (10.0, 20.0),
        (2.0, 20.0),
        (1.0, 100.0),
    ):
        signals = signals_of(seeds, rate_hz)
        base = run(signals, rate_hz=rate_hz, fixed_gain=gain)
        for name, switches in (
            ("plain step K dt", Switches(step_is_plain=True, bias_by_step=True)),
            ("bias by gamma/2 dt", Switches(bias_by_step=True)),
        ):
            costs = run(signals, switches, rate_hz=rate_hz, fixed_gain=gain)
            where = f"{rate_hz:g} Hz, K = {gain:g}"
            rows.append({**line(f"{where}: {name}", costs, base), "as_built": base.mean()})
    return rows


def retuned_table(tuning, judging, cycles):
    rows, base = [], None
    for name, switches, rules in (
        ("as built", Switches(), AS_BUILT),
        ("rate: low-passed |de/dt|", Switches(rate=RECTIFIED), AS_BUILT),
        ("rate: |de/dt| as it is", Switches(rate=UNFILTERED), AS_BUILT),
        ("rate: none (0)", Switches(rate=NO_RATE), AS_BUILT),
        ("e from the truth", Switches(error_is_true=True), AS_BUILT),
        ("v3 not normalised", Switches(cross_is_unit=False), AS_BUILT),
        ('table\'s "V" is VL', Switches(), V_AS_VERY_LARGE),
        ("rows are e, columns its rate", Switches(), ROWS_AS_ERROR),
    ):
        best, _ = search_once(
            lambda k, switches=switches, rules=rules: run(
                tuning, switches, rules, candidates=k
            ).mean(axis=1),
            cycles,
        )
        costs = run(judging, switches, rules, candidates=best[None, :])[0]
        base = costs if base is None else base
        rows.append(line(name, costs, base))
    return rows


def colony_table(judging, cycles, search_seeds):
    objective = PaperTask(midpoint_profile(), ("membership",), tuple(TUNING_SEEDS), ()).objective
    rows = []
    for name, options in (
        ("as built: alpha in [-1, 1], by 1/(1 + J)", {}),
        ("alpha in [0, 1]", {"positive": True}),
        ("onlookers by J", {"by_cost": True}),
        ("both as printed", {"positive": True, "by_cost": True}),
        ("a scout after 50 failures", {"limit": 50}),
    ):
        found = [search_once(objective.costs, cycles, seed, **options) for seed in search_seeds]
        best = np.array([k for k, _ in found])
        told, judged = objective.costs(best), run(judging, candidates=best).mean(axis=1)
        rows.append({
            "change": name, "tuning": told.mean(), "tuning_spread": np.ptp(told),
            "judging": judged.mean(), "judging_spread": np.ptp(judged),
            "scouts": float(np.mean([scouts for _, scouts in found])),
        })  # fmt: skip
    return rows


def print_table(title, rows):
    print(f"\n{title}")
    for row in rows:
        rest = "  ".join(f"{key} {value:.4g}" for key, value in row.items() if key != "change")
        print(f"  {row['change']:<44} {rest}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    cycles = 3 if options.quick else CYCLES
    seeds = JUDGING_SEEDS[:4] if options.quick else JUDGING_SEEDS
    search_seeds = SEARCH_SEEDS[:1] if options.quick else SEARCH_SEEDS
    judging, tuning = signals_of(seeds), signals_of(TUNING_SEEDS)
    tables = {
        "shipped": shipped_table(judging, seeds),
        "long_steps": long_step_table(seeds),
        "retuned": retuned_table(tuning, judging, cycles),
        "colony": colony_table(judging, cycles, search_seeds),
    }
    if options.json:
        print(json.dumps(tables))
        return
    for title, rows in tables.items():
        print_table(title, rows)


if __name__ == "__main__":
    main()
