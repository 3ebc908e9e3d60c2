"""For how long is gravity best averaged: does a fuzzy rule choose better than the law in use?

    python benchmarks/averaging.py DIR DIR ...

On 90 s in the middle of each recording (BROAD's format), at about 100 samples a second, as recorded
and with a propeller: 1.5 to 5 m/s^2 at 50 to 200 Hz, wandering by 2 %, which the stream aliases.
Error of the inclination, degrees RMS, mean over a folder's recordings: the ``usual`` time; the
``law``, as it runs; the ``law held``, at the time it has arrived at; the fuzzy ``rule``, held; and
the ``best`` of ten times in hindsight. The rule has the paper's Table I on two logarithms: how
much the mean force of 0.5 s turns, in the accelerometer's own errors, and how many times more than
that of 8 s. Six numbers, tuned by bees on the recordings of all other folders.
"""

import sys
from dataclasses import replace

import numpy as np
from common.filters import ENU_SENSOR_OF_NED_FRD, body_readings
from common.paper_laws import tune
from common.recordings import Array, Trial, add_folders, chosen_sets
from common.report import Row, parser, show
from common.scores import errors_deg, heading_free
from scipy.signal import lfilter

from estimator.conditioning.vertical.averaging import LEAST_VARIANCE, Averaging
from estimator.filter.noise_gain import consequent
from estimator.live.settings import settings_of
from estimator.profile import load_profile, merge_profile
from fuzzbee import Estimator
from tuning.space import Space

CLIP_S, RATE_HZ, LEARNT_S, PARTS = 90.0, 100.0, 10.0, 4
TAUS_S = np.geomspace(0.25, 16.0, 10)
USUAL_S = settings_of(load_profile("imu")).conditioning.gravity_tau_s
SHORT, LONG = 1, 5  # octaves: windows of 0.5 and of 8 s
FOOD_SOURCES, CYCLES = 20, 60
# Times from ``shortest_s`` to exp(Q3) as long; a term for each 1/Q1 and 1/Q2 of a logarithm.
RULE = Space(
    ("Q1", "Q2", "Q3", "shortest_s", "first", "second"),
    (0.1, 0.1, 0.1, 0.25, -3.0, -4.0),
    (4.0, 4.0, 4.2, 4.0, 5.0, 2.0),
    (),
    (True, True, False, True, False, False),
)


def middle(trial: Trial) -> Trial:
    """The clip around the middle of what is scored."""
    rows, n = np.flatnonzero(trial.scored), round(CLIP_S * trial.rate_hz)
    start = max(0, int(rows[len(rows) // 2]) - n // 2)
    return trial.cut(slice(start, start + n, max(1, round(trial.rate_hz / RATE_HZ))))


def with_propeller(trial: Trial, seed: int) -> Trial:
    """The same with a propeller's vibration."""
    rng, n = np.random.default_rng(seed), len(trial.acc_m_s2)
    rate_hz, size_m_s2 = rng.uniform(50.0, 200.0), rng.uniform(1.5, 5.0)
    kept = np.exp(-trial.dt_s / 3.0)
    wander = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.normal(size=n))
    phase = 2.0 * np.pi * trial.dt_s * np.cumsum(rate_hz * (1.0 + 0.02 * wander))
    axes = rng.normal(size=(2, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    shaken = np.outer(np.sin(phase), axes[0]) + 0.5 * np.outer(np.cos(phase + 0.7), axes[1])
    return replace(trial, acc_m_s2=trial.acc_m_s2 + size_m_s2 * shaken)


def averaging_of(value: object) -> Averaging | None:
    """What a state, a tuple of tuples, says of averaging."""
    if isinstance(value, Averaging) or not isinstance(value, tuple):
        return value if isinstance(value, Averaging) else None
    return next((found for each in value if (found := averaging_of(each))), None)


def run(trial: Trial, conditioning: dict[str, object]) -> tuple[float, Array]:
    """RMS error of the inclination; and both inputs of the rule, and the law's time (s)."""
    estimator = Estimator(
        merge_profile(load_profile("imu"), {"conditioning": conditioning}), trial.rate_hz
    )
    q, seen = [], []
    for rows in np.array_split(np.arange(len(trial.moving)), PARTS):
        part = (column[rows[0] : rows[-1] + 1] for column in body_readings(trial))
        q.append(estimator.update_batch(*part).q_ned_frd)
        now = averaging_of(estimator._inner._state.core.core.conditioning)  # noqa: SLF001
        short, long = (max(now.octaves[k].apart, 1e-2 * LEAST_VARIANCE) for k in (SHORT, LONG))
        seen.append((np.log(short / LEAST_VARIANCE), np.log(short / long), now.factor * USUAL_S))
    scored = trial.scored & (trial.times_s > LEARNT_S)
    estimates = np.concatenate(q) @ ENU_SENSOR_OF_NED_FRD
    if not trial.has_mag:
        estimates = heading_free(estimates, trial.q_enu_sensor, scored)
    inclination = errors_deg(estimates, trial.q_enu_sensor)[scored, 2]
    return float(np.sqrt(np.mean(inclination**2))), np.array(seen[1:]).mean(axis=0)


def measured(trial: Trial) -> Row:
    """The law's error as it runs, what it saw, and the errors at all times held (10,)."""
    error, seen = run(trial, {})
    held = [
        run(trial, {"use_averaging": False, "gravity_tau_s": tau})[0] for tau in TAUS_S.tolist()
    ]
    return {"law": error, "seen": seen, "held": np.array(held)}


def held_error(row: Row, tau_s: float) -> float:
    """The error with a time that is held, between those that were run."""
    return float(np.exp(np.interp(np.log(tau_s), np.log(TAUS_S), np.log(row["held"]))))


def ruled_s(p: Array, seen: Array) -> float:
    """The rule's time: Table I between its entries."""
    terms = np.clip(p[:2] * (seen[:2] - p[4:6]), 0.0, 4.0)
    return float(p[3] * np.exp(p[2] * consequent(terms[0], terms[1])))


def tuned_rule(rows: list[Row], cycles: int) -> Array:
    """The rule's numbers with the lowest mean logarithm of the errors of these recordings."""

    def cost(values: Array) -> Array:
        errors = [[held_error(row, ruled_s(p, row["seen"])) for row in rows] for p in values]
        return np.asarray(np.log(errors).mean(axis=1))

    return tune(RULE, cost, FOOD_SOURCES, cycles)[0]


def judged(rows: list[Row], rule: Array) -> Row:
    """Means over a folder's recordings."""
    columns = {
        "usual": [held_error(row, USUAL_S) for row in rows],
        "law": [row["law"] for row in rows],
        "law held": [held_error(row, row["seen"][2]) for row in rows],
        "rule": [held_error(row, ruled_s(rule, row["seen"])) for row in rows],
        "best": [row["held"].min() for row in rows],
    }
    return {name: float(np.mean(errors)) for name, errors in columns.items()}


def main() -> int:
    made = parser(__doc__)
    add_folders(made)
    options = made.parse_args()
    found: dict[str, dict[str, list[Row]]] = {}
    for name, trials in chosen_sets(options).items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        clips = [middle(trial) for trial in trials]
        shaken = [with_propeller(clip, seed) for seed, clip in enumerate(clips)]
        found[name] = {
            "as recorded": [measured(clip) for clip in clips],
            "with a propeller": [measured(clip) for clip in shaken],
        }
    table = []
    for name, conditions in found.items():
        others = {n: c for n, c in found.items() if n != name} or found  # one alone: itself
        rows = [row for c in others.values() for rows in c.values() for row in rows]
        rule = tuned_rule(rows, 2 if options.smoke else CYCLES)
        table += [{"folder": name, "": how, **judged(c, rule)} for how, c in conditions.items()]
    show({"error of inclination, degrees RMS": table}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
