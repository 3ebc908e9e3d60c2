"""What retuning while it runs is worth: the paper's signals, whose noise changes in mid-run.

A minute at 100 Hz with the profile ``paper``, and at 20 s one change: the noise of the vectors or
of the gyroscope times 2 or 5, a magnet beside the vehicle, a step of the gyroscope's bias; or none.
Scored is the mean of e, against the truth, from 20 s to the end (and from 40 s on). The rivals:

* as it is shipped;
* the rule of two: noise twice as large in the vectors halves their confidences, in the
  gyroscope doubles them;
* multiple models: five filters side by side, confidences times 1/9 to 9; each five seconds
  the one that foretells its vectors best is taken;
* random search in place of the colony, with as many candidates.
"""

import argparse
import json
import sys
from math import log2
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from estimator.types import ImuSample
from tuning.online.cost import cost_on
from tuning.online.noise import noise_of
from tuning.online.numbers import numbers_of, with_factors
from tuning.online.retuned_estimator import RetunedEstimator, SegmentingEstimator
from tuning.online.retuner import Retuner
from tuning.online.search import CYCLES, FOOD_SOURCES
from tuning.online.segment import Window
from tuning.paper_noise import NoiseScale, simulate_scaled
from tuning.prediction import readings_of
from tuning.space import decode, random_positions

RATE_HZ = 100.0
SAMPLES = 6001
CHANGE = 2000
LATE = 4000
BASE = load_profile("paper")
MODELS = (1 / 9, 1 / 3, 1.0, 3.0, 9.0)
MAGNET_GAUSS = (0.15, 0.1, 0.0)  # along body forward and right
BIAS_STEP_RAD_S = (0.1, -0.1, 0.1)


def step(factor):
    return np.where(np.arange(SAMPLES) < CHANGE, 1.0, factor)


def signals(name, seed):
    """The readings of a scenario as samples, and the truth (N, 4)."""
    noise = {
        "vectors x2": NoiseScale(vectors=step(2.0)),
        "vectors x5": NoiseScale(vectors=step(5.0)),
        "gyroscope x2": NoiseScale(gyroscope=step(2.0)),
        "gyroscope x5": NoiseScale(gyroscope=step(5.0)),
    }.get(name, NoiseScale())
    made = simulate_scaled(seed, SAMPLES, noise, RATE_HZ)
    gyr, mag = made.gyr_rad_s.copy(), made.mag_gauss.copy()
    if name == "magnet":
        mag[CHANGE:] += MAGNET_GAUSS
    if name == "bias":
        gyr[CHANGE:] += BIAS_STEP_RAD_S
    columns = (gyr, made.acc_m_s2, mag)
    samples = [
        ImuSample(int(made.time_us[k]), *(tuple(c[k].tolist()) for c in columns), True)
        for k in range(SAMPLES)
    ]
    return samples, made.q_ned_frd


def fly(estimator, samples, after=lambda: None):
    """Attitudes (N, 4); ``after`` is called behind each sample."""
    q = np.empty((len(samples), 4))
    for k, sample in enumerate(samples):
        estimator.update(sample)
        after()
        q[k] = estimator.attitude(sample.time_us).q_ned_frd
    return q


def factors(gain):
    """The confidences times ``gain``, other numbers as they are."""
    return np.array([gain if number.name == "gain" else 1.0 for number in numbers_of(BASE)])


def shipped(samples, _seed):
    return fly(SegmentingEstimator(BASE), samples), 0


def retuned(samples, seed):
    return _with(Retuner(BASE, seed), samples)


def random_look(space, kept, evaluate, generator):
    """As many candidates as the colony tries, drawn evenly."""
    drawn = random_positions(space, FOOD_SOURCES * (1 + 2 * CYCLES) - 1, generator)
    factors = np.concatenate([kept[:1].clip(space.lower, space.upper), decode(space, drawn)])
    return factors, evaluate(factors), kept


def by_chance(samples, seed):
    return _with(Retuner(BASE, seed, random_look), samples)


def _with(retuner, samples):
    estimator = RetunedEstimator(BASE, retuner=retuner)
    q = fly(estimator, samples)
    return q, len(estimator.decisions)


def rule_of_two(samples, _seed):
    """The factor follows the noise of the last five seconds over that of the first five."""
    learnt, changes = [], [0]

    def take(segment):
        now = noise_of(readings_of(segment.samples))
        if not learnt:
            learnt.append(now)
            return
        was = learnt[0]
        vectors = log2((now.gravity + now.magnetic) / (was.gravity + was.magnetic)) / 2
        gyroscope = log2(now.gyroscope / was.gyroscope) / 2
        if abs(vectors) > 0.5 or abs(gyroscope) > 0.5:
            estimator.replace_profile(with_factors(BASE, factors(2.0 ** (gyroscope - vectors))))
            changes[0] += 1

    estimator = SegmentingEstimator(BASE, None, take)
    return fly(estimator, samples), changes[0]


def multiple_models(samples, _seed):
    """What foretells best over a segment is taken for the next one."""
    attitudes = [fly(SegmentingEstimator(with_factors(BASE, factors(g))), samples) for g in MODELS]
    parts = []
    fly(SegmentingEstimator(BASE, None, parts.append), samples)
    q, taken, begin, changes = attitudes[2].copy(), 2, 0, 0
    for part in parts:
        end = begin + len(part.samples)
        q[begin:end] = attitudes[taken][begin:end]
        window = Window(part, part)
        costs = [cost_on(with_factors(BASE, factors(g)), window, judged=False) for g in MODELS]
        best = int(np.argmin([np.mean(c.blocks) for c in costs]))
        changes += best != taken
        taken, begin = best, end
    q[begin:] = attitudes[taken][begin:]
    return q, changes


METHODS = {
    "shipped": shipped,
    "retuned": retuned,
    "random search": by_chance,
    "rule of two": rule_of_two,
    "multiple models": multiple_models,
}
SCENARIOS = (
    "no change",
    "vectors x2",
    "vectors x5",
    "gyroscope x2",
    "gyroscope x5",
    "magnet",
    "bias",
)


def mean_e(q, truth, first=CHANGE):
    e = np.sin(0.5 * batch_angle_errors(q, truth)[:, 0]) ** 2
    return float(e[first:].mean())


def run(scenarios, seeds, methods):
    found = {}
    for scenario in scenarios:
        rows = found.setdefault(scenario, {})
        for seed in seeds:
            samples, truth = signals(scenario, seed)
            for name in methods:
                q, changes = METHODS[name](samples, seed)
                row = rows.setdefault(name, {"e": [], "late": [], "changes": []})
                row["e"].append(mean_e(q, truth))
                row["late"].append(mean_e(q, truth, LATE))
                row["changes"].append(changes)
        show(scenario, rows)
    return found


def show(scenario, rows):
    base = rows.get("shipped")
    for name, row in rows.items():
        e, late = np.mean(row["e"]), np.mean(row["late"])
        more = ""
        if base is not None and name != "shipped":
            each = np.array(row["e"]) / np.array(base["e"]) - 1.0
            more = (
                f" {100 * (e / np.mean(base['e']) - 1):+6.1f} %"
                f" late {100 * (late / np.mean(base['late']) - 1):+6.1f} %"
                f" worst seed {100 * each.max():+6.1f} %"
            )
        changes = np.mean(row["changes"])
        line = f"{scenario:13} {name:16} e {e:.5f} {late:.5f}{more}  changes {changes:.1f}"
        print(line, file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object, every seed in it")
    parser.add_argument("--seeds", default="400-403", help="A-B, both included")
    parser.add_argument("--scenarios", default=",".join(SCENARIOS))
    parser.add_argument("--methods", default=",".join(METHODS))
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    result = run(options.scenarios.split(","), range(first, last + 1), options.methods.split(","))
    if options.json:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
