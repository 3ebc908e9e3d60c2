"""What the fuzzy gain is good for: against simpler gains and against Kalman filters.

Every way to set the gain is tuned by the same bee colony with one budget, on the same noise
seeds at the paper's noise, and scored on others at 1, 2 and 5 times the noise of the vectors
and of the gyroscope: J, mean e over 4..14 s and over 30..60 s, median time to e < 0.01 (s).
The profiles are scored as they ship. ``best fixed K there`` is chosen in hindsight, for that
noise on those seeds, column by column.

python benchmarks/gains.py [--json] [--plot FILE] [--seeds 5000-5039] [--mixes 1x1,1x2,5x1]
"""

import argparse
import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from gain_laws import FIXED, FUZZY, LAWS, NOISE, Law, law_errors
from gain_mekf import FILTERS, filter_errors

from drivers.simulation.simulated_vehicle import FIELD_GAUSS
from estimator.errors import InputError
from estimator.filter import memberships
from estimator.filter.alignment import align
from estimator.filter.observation import raw_vectors
from estimator.geometry.metrics import STEADY, TRANSIENT, TRANSIENT_WEIGHT
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from fuzzbee.replays.command import seed_range
from tuning.optimizers import run_search
from tuning.paper_experiment import SETTLED_ERROR
from tuning.paper_noise import NoiseScale, simulate_scaled
from tuning.paper_task import FIRST_RESERVED_SEED
from tuning.search import Search, SearchOptions
from tuning.space import Space, bounds, membership_space

TUNING_SEEDS = range(100, 108)
FOOD_SOURCES = 20
RATE_HZ = 100.0
COST_STOP = STEADY.stop  # samples that J needs
SAMPLES = 6_001
LATE = slice(3_000, 6_001)
MIXES = "1x1,1x2,1x5,2x1,5x1"
HINDSIGHT_GAINS = (0.5, 0.7, 1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70, 100)
COLUMNS = ("cost", "early", "late", "settling_s")


class Signals(NamedTuple):
    """S seeds of N samples; ``aligned`` (S, 4) are the attitudes that the first sample shows."""

    gyr: np.ndarray
    acc: np.ndarray
    mag: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    aligned: np.ndarray


def signals(settings, seeds, samples, scale):
    runs = [simulate_scaled(seed, samples, scale, RATE_HZ) for seed in seeds]
    first = [
        raw_vectors(settings.reference, tuple(r.acc_m_s2[0]), tuple(r.mag_gauss[0]), True)
        for r in runs
    ]
    return Signals(
        np.array([r.gyr_rad_s for r in runs]),
        np.array([r.acc_m_s2 for r in runs]),
        np.array([r.mag_gauss for r in runs]),
        runs[0].q_ned_frd.copy(),
        np.tile(np.array(settings.initial), (len(runs), 1)),
        np.array([align(vectors) for vectors in first]),
    )


def errors_of(name, law, settings, on, candidates):
    """The true e (C, S, N)."""
    candidates = np.asarray(candidates, dtype=np.float64)
    if name in FILTERS:
        v1, v2 = on.mag / FIELD_GAUSS, -on.acc / STANDARD_GRAVITY_M_S2
        i1, i2 = (np.array(v) for v in settings.reference[:2])
        return filter_errors(law.kind, candidates, on.start, on.gyr, v1, v2, i1, i2, on.truth)
    starts = on.aligned if law.aligned else on.start
    return law_errors(
        law.kind,
        candidates,
        settings.filter,
        settings.reference,
        starts,
        on.gyr,
        on.acc,
        on.mag,
        on.truth,
    )


def costs(e):
    """J of e (..., N)."""
    return TRANSIENT_WEIGHT * e[..., TRANSIENT].sum(-1) + e[..., STEADY].sum(-1)


def tune(name, law, settings, on, cycles):
    """The parameters (D,) with the lowest mean J on the signals, and that J."""
    space = membership_space() if law.kind == FUZZY else scales(law)

    def evaluate(values):
        return costs(errors_of(name, law, settings, on, values)).mean(axis=1)

    limit = FOOD_SOURCES * space.dimensions
    search = Search(space, SearchOptions("abc", FOOD_SOURCES, cycles, limit, 0), evaluate)
    run_search(search, np.mean(bounds(space), axis=0))
    return search.best_values, search.best_cost


def scales(law):
    """All parameters are scales: searched by their logarithm."""
    return Space(law.names, law.lower, law.upper, (), (True,) * len(law.names))


def figures(e):
    """What is reported of e (S, N)."""
    below = e < SETTLED_ERROR
    settled = np.where(below.any(axis=1), below.argmax(axis=1), np.inf)
    J = costs(e)
    return {
        "cost": float(J.mean()),
        "cost_standard_error": float(J.std(ddof=1) / np.sqrt(len(J))) if len(J) > 1 else None,
        "early": float(e[:, STEADY].mean()),
        "late": float(e[:, LATE].mean()),
        "settling_s": float(np.median(settled) / RATE_HZ),
    }


def contenders(settings, cycles):
    """Everything that is scored: by name its law, parameters and result of tuning."""
    on = signals(settings, TUNING_SEEDS, COST_STOP, NoiseScale())
    rows = {}
    for name, law in {**LAWS, "fuzzy, tuned likewise": Law(FUZZY), **FILTERS}.items():
        print(f"tuning: {name} ...", file=sys.stderr, flush=True)
        values, cost = tune(name, law, settings, on, cycles)
        names = law.names or memberships.NAMES
        rows[name] = (
            law,
            values,
            {"tuning_cost": cost, **dict(zip(names, values.tolist(), strict=True))},
        )
    rows["profile paper"] = (Law(FUZZY), np.array(load_profile("paper").k), {})
    rows["profile adaptive"] = (Law(NOISE), np.zeros(1), {})
    return rows


def score(settings, rows, seeds, mix):
    gyroscope, vectors = mix
    on = signals(settings, seeds, SAMPLES, NoiseScale(gyroscope, vectors))
    found = {
        name: figures(errors_of(name, law, settings, on, values[None])[0])
        for name, (law, values, _) in rows.items()
    }
    grid = [
        figures(errors_of("", Law(FIXED), settings, on, [[gain]])[0]) for gain in HINDSIGHT_GAINS
    ]
    best = {column: min(g[column] for g in grid) for column in COLUMNS}
    at = {f"{c}_gain": HINDSIGHT_GAINS[int(np.argmin([g[c] for g in grid]))] for c in COLUMNS}
    found["best fixed K there"] = {**best, **at}
    return found


def label(mix):
    gyroscope, vectors = mix
    return f"gyroscope x{gyroscope:g}, vectors x{vectors:g}"


def show(result):
    print(f"{'tuned parameters':40} J on the tuning seeds")
    for name, parameters in result["parameters"].items():
        values = {k: v for k, v in parameters.items() if k != "tuning_cost"}
        text = ", ".join(f"{k} {v:.3g}" for k, v in values.items()) if len(values) < 8 else ""
        if parameters:
            print(f"{name:40} {parameters['tuning_cost']:.3f}  {text}")
    for mix, rows in result["mixes"].items():
        print(f"\n{mix:40} {'J':>8} {'e 4..14':>9} {'e 30..60':>9} {'settled s':>9}")
        for name, row in rows.items():
            print(
                f"{name:40} {row['cost']:8.3f} {row['early']:9.5f} {row['late']:9.5f} "
                f"{row['settling_s']:9.3f}"
            )


def plot(result, path):
    """e over that of the fixed gain that is best for the noise in hindsight, early and late."""
    from matplotlib.figure import Figure

    mixes = result["mixes"]
    names = [name for name in next(iter(mixes.values())) if name != "best fixed K there"]
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    panels = (("early", "e over 4..14 s"), ("late", "e over 30..60 s"), ("settling_s", "settling"))
    for ax, (column, title) in zip(axes, panels, strict=True):
        for i, (mix, rows) in enumerate(mixes.items()):
            base = rows["best fixed K there"][column]
            ratios = [rows[name][column] / base for name in names]
            offsets = np.arange(len(names)) + 0.12 * (i - 0.5 * (len(mixes) - 1))
            ax.plot(ratios, offsets, "o", ms=4.5, color=f"C{i}", label=mix)
        ax.axvline(1.0, color="0.4", lw=0.8)
        ax.set(title=title, xlabel="over the best fixed K's")
        ax.set_xscale("linear" if column == "settling_s" else "log")
        ax.grid(visible=True, axis="x", which="both", alpha=0.25)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(mixes), fontsize="small")
    figure.savefig(path, dpi=150)


def noise_mixes(text):
    """GxV by commas: times the gyroscope's noise, times the vectors'."""
    try:
        return [tuple(float(x) for x in one.split("x", 1)) for one in text.split(",")]
    except ValueError:
        raise SystemExit(f"--mixes: {text!r} is not like {MIXES}") from None


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw early, late and settling")
    parser.add_argument("--seeds", default="5000-5039", help="noise seeds that are scored on")
    parser.add_argument("--mixes", default=MIXES, help="GxV: times gyroscope's x vectors' noise")
    parser.add_argument("--cycles", type=int, default=50, help="20 (1 + 2 cycles) evaluations each")
    return parser.parse_args()


def main():
    options = arguments()
    try:
        seeds = seed_range(options.seeds)
    except InputError as error:
        raise SystemExit(str(error)) from None
    settings = settings_of(load_profile("paper"))
    rows = contenders(settings, options.cycles)
    mixes = {}
    for mix in noise_mixes(options.mixes):
        print(f"scoring: {label(mix)} ...", file=sys.stderr, flush=True)
        mixes[label(mix)] = score(settings, rows, seeds, mix)
    result = {
        "seeds": options.seeds,
        "reserved": seeds[0] >= FIRST_RESERVED_SEED,
        "parameters": {name: found for name, (_, _, found) in rows.items()},
        "mixes": mixes,
    }
    if options.plot is not None:
        plot(result, options.plot)
    if options.json:
        print(json.dumps(result))
    else:
        show(result)


if __name__ == "__main__":
    main()
