"""What is retuning while it runs worth, where the noise changes in mid-run?

    python benchmarks/retuning.py [--seeds 400-403] [--scenarios ...] [--methods ...]

A minute of the paper's signals at 100 Hz with the profile ``paper``, and at 20 s one change: the
noise of the vectors, of the gyroscope or of both times 2 or 5, at once or within 30 s, a magnet
beside the vehicle, a step of the gyroscope's bias; or none. ``e`` is the mean error against the
truth from 20 s to the end, ``late`` from 40 s on; ``change`` and ``late change`` are against the
profile as it is shipped, in percent, ``worst seed`` the largest. For comparison: random search in
place of the colony, with as many candidates.
"""

from argparse import Namespace
from collections.abc import Callable
from typing import Any

import numpy as np
from common.recordings import Array
from common.report import Row, Tables, benchmark, names, option, seeds

from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from estimator.types import ImuSample
from tests.paper_noise import NoiseScale, samples_of, simulate_scaled
from tuning.online.retuner import RetunedEstimator, Retuner
from tuning.search import Search
from tuning.space import random_positions

RATE_HZ, SAMPLES, CHANGE, LATE = 100.0, 6001, 2000, 4000
SLOWLY = 3000  # samples in which noise grows slowly
BASE = load_profile("paper")
MAGNET_GAUSS = (0.15, 0.1, 0.0)  # along body forward and right
BIAS_STEP_RAD_S = (0.1, -0.1, 0.1)
NOISES = {
    "no change": (1.0, 1.0),  # gyroscope, vectors
    "vectors x2": (1.0, 2.0),
    "vectors x5": (1.0, 5.0),
    "gyroscope x2": (2.0, 1.0),
    "gyroscope x5": (5.0, 1.0),
    "both x5": (5.0, 5.0),
    "vectors slowly x5": (1.0, 5.0),
    "magnet": (1.0, 1.0),
    "bias": (1.0, 1.0),
}
Samples = list[ImuSample]


def signals(name: str, seed: int, count: int) -> tuple[Samples, Array]:
    """The readings of a scenario as samples, and the truth (N, 4)."""
    since = np.arange(count) - CHANGE
    grown = np.clip(since / SLOWLY, 0.0, 1.0) if "slowly" in name else since >= 0
    steps = [factor**grown for factor in NOISES[name]]
    made = simulate_scaled(seed, count, NoiseScale(*steps), RATE_HZ)
    gyr, mag = made.gyr_rad_s.copy(), made.mag_gauss.copy()
    if name == "magnet":
        mag[CHANGE:] += MAGNET_GAUSS
    if name == "bias":
        gyr[CHANGE:] += BIAS_STEP_RAD_S
    return [*samples_of(made._replace(gyr_rad_s=gyr, mag_gauss=mag))], made.q_ned_frd


def fly(estimator: Estimator, samples: Samples) -> Array:
    """Attitudes (N, 4)."""
    q = np.empty((len(samples), 4))
    for k, sample in enumerate(samples):
        estimator.update(sample)
        q[k] = estimator.attitude(sample.time_us).q_ned_frd
    return q


def random_look(search: Search, kept: Array, generator: np.random.Generator) -> Array:
    """As many candidates as the colony tries, drawn evenly."""
    drawn = random_positions(search.space, search.left - 1, generator)
    search.costs(np.concatenate([kept[:1], drawn]))
    return kept


def by_retuner(samples: Samples, seed: int, *how: Any) -> tuple[Array, int]:
    estimator = RetunedEstimator(BASE, retuner=Retuner(BASE, seed, *how))
    return fly(estimator, samples), len(estimator.decisions)


METHODS: dict[str, Callable[[Samples, int], tuple[Array, int]]] = {
    "shipped": lambda samples, _seed: (fly(Estimator(BASE), samples), 0),
    "retuned": by_retuner,
    "random search": lambda samples, seed: by_retuner(samples, seed, random_look),
}


def row(scenario: str, name: str, found: Array, base: Array) -> Row:
    """Of e, late e and changes (S, 3) by seed, beside those of the profile as shipped."""
    e, late, changes = found.mean(axis=0).tolist()
    more = 100.0 * (found.mean(axis=0)[:2] / base.mean(axis=0)[:2] - 1.0)
    worst = 100.0 * (found[:, 0] / base[:, 0] - 1.0).max()
    return {
        "from 20 s on": scenario,
        "method": name,
        "e": e,
        "late": late,
        "change %": float(more[0]),
        "late change %": float(more[1]),
        "worst seed %": float(worst),
        "changes": changes,
    }


@benchmark(
    option("--seeds", type=seeds, default=range(400, 404)),
    option("--scenarios", default=",".join(NOISES)),
    option("--methods", default=",".join(METHODS)),
)
def main(options: Namespace) -> Tables:
    count = SAMPLES
    if options.smoke:
        options.seeds, options.scenarios, count = options.seeds[:1], "vectors x5", LATE + 500
    table: list[Row] = []
    chosen = names(METHODS, options.methods)
    for scenario in names(NOISES, options.scenarios):
        found: dict[str, list[tuple[float, float, int]]] = {}
        for seed in options.seeds:
            samples, truth = signals(scenario, seed, count)
            for name in dict.fromkeys(["shipped", *chosen]):
                q, changes = METHODS[name](samples, seed)
                e = np.sin(0.5 * batch_angle_errors(q, truth)[:, 0]) ** 2
                figures = (float(e[CHANGE:].mean()), float(e[LATE:].mean()), changes)
                found.setdefault(name, []).append(figures)
        base = np.array(found["shipped"], dtype=float)
        table += [
            row(scenario, name, np.array(some, dtype=float), base) for name, some in found.items()
        ]
    return {"mean e where something changes at 20 s": table}
