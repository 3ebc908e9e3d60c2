"""What does each tuned number move?

    python benchmarks/sensitivity.py DIR [DIR ...] [--logs LOG [LOG ...]] [--flights A-B]

Every numeric key of conditioning and aiding is multiplied by 0.7 and 1.4, and each switch is turned
off. A row a number: the largest change of an error (percent of it, at least ``LEAST_DEG``) or
of a recovery time, and of a coverage, and on which set. Sets are folders of recordings as they are,
with turns that no sensor has felt, and with magnets that pass (seed 0); logs with a truth; and
simulated flights of these seeds at 50 and at 4 Hz. What flies does so with velocity, without, and
with velocity that is lost from 0.4 to 0.8 of the flight. A set's figure is the mean over it, since
a single flight's moves by chance. The last line counts the numbers that move nothing: no error by
1 %, no coverage by 0.02.
"""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common.filters import fuzzbee
from common.recordings import Trial, chosen_sets
from common.report import FOLDERS, Row, Tables, benchmark, names, option, seeds
from common.scores import LEAST_ROWS, errors_deg, heading_free, rms
from common.ways import WAYS
from flying.cases import CASES, DURATION_S, recorded
from flying.replayed import UNAIDED, Events, changed, fly, read, start_us
from rich.console import Console
from rich.progress import track
from turns import MOST_ALONE_DEG, turn_about

from drivers.events import Imu
from estimator.errors import InputError
from estimator.profile import load_profile, merge_profile, profile_to_json

SECTIONS = ("conditioning", "aiding")
FACTORS = (0.7, 1.4)
LEAST_DEG, LEAST_SHARE, LEAST_COVERAGE = 0.3, 0.01, 0.02
SETTLED_S, FLIGHT_SETTLED_S = 5.0, 30.0
TURN_AT_S, WITHIN_S, FOUND_DEG = 20.0, 15.0, 5.0
TURNS_ENU_DEG = (((0, 0, 1), 60.0), ((0, 1, 0), 179.0))
SEED = 0

Changes = dict[str, Any]
Score = Callable[[Changes], list[float]]


class Question(NamedTuple):
    """A number, and what is made of it."""

    name: str
    change: str
    profile: Changes


def scores(folders: dict[str, list[Trial]], flown: dict[str, list[Events]]) -> dict[str, Score]:
    """By the set's name how a profile does on it."""
    made: dict[str, Score] = {}

    def add(name: str, of: Callable[[Changes, Any], list[float]], items: list[Any]) -> None:
        made[name] = lambda changes: mean([of(changes, each) for each in items])

    for folder, trials in folders.items():
        with_field = [trial for trial in trials if trial.has_mag]
        rngs = [np.random.default_rng([SEED, k]) for k in range(len(with_field))]
        magnets = [WAYS["magnets pass"](t, rng) for t, rng in zip(with_field, rngs, strict=True)]
        add(folder, on_trial, trials)
        add(f"{folder}, turned", after_turn, with_field)
        add(f"{folder}, magnets", on_trial, [trial for some in magnets for trial in some])
    for name, flights in flown.items():
        add(name, on_flight, flights)
        add(f"{name}, velocity lost", on_flight, [without(each, 0.4, 0.8) for each in flights])
        add(f"{name}, no velocity", unaided, flights)
    return made


def mean(rows: list[list[float]]) -> list[float]:
    """Column by column, without what is not a number."""
    means: list[float] = np.ma.masked_invalid(rows).mean(axis=0).filled(0.0).tolist()
    return means


def on_trial(changes: Changes, trial: Trial) -> list[float]:
    """Errors RMS of inclination and heading (deg) and their coverages, in motion and at rest."""
    q, sigma = fuzzbee(changes)(trial).advance(slice(0, None))
    if trial.name in OWN_HEADING:
        q = heading_free(q, trial.q_enu_sensor, trial.scored)
    errors = errors_deg(q, trial.q_enu_sensor)
    known = ~np.isnan(errors).any(axis=1) & (trial.times_s > SETTLED_S)
    _, heading, inclination = rms(errors[known & trial.moving])
    found = [inclination, heading if trial.has_mag else np.nan]
    for rows in (known & trial.moving, known & ~trial.moving):
        under = errors[rows][:, [2, 1]] <= sigma[rows]
        found += under.mean(axis=0).tolist() if len(under) >= LEAST_ROWS else [np.nan, np.nan]
    return found


def after_turn(changes: Changes, trial: Trial) -> list[float]:
    """Seconds until a turn about up and one about north are found, where the estimate is right."""
    row = round(TURN_AT_S * trial.rate_hz)
    rows = slice(row, row + round(WITHIN_S * trial.rate_hz))
    found = []
    for axis, angle_deg in TURNS_ENU_DEG:
        run = fuzzbee(changes)(trial)
        before = run.advance(slice(0, row)).q_enu_sensor
        alone = errors_deg(before, trial.q_enu_sensor[:row])[-1, 0]
        run.turn(turn_about(axis, angle_deg))
        total = errors_deg(run.advance(rows).q_enu_sensor, trial.q_enu_sensor[rows])[:, 0]
        hits = np.flatnonzero(total < FOUND_DEG)
        time_s = hits[0] * trial.dt_s if len(hits) else WITHIN_S
        found.append(time_s if alone < MOST_ALONE_DEG else np.nan)
    return [*found, *4 * [np.nan]]


def without(events: Events, begin: float, end: float) -> Events:
    """The flight without velocity between these shares of it."""
    last_us = max(event.sample.time_us for event in events if isinstance(event, Imu))
    length_s = 1e-6 * (last_us - start_us(events))
    span = begin * length_s, end * length_s
    return changed(
        events, velocity=lambda at_s, sample, _: None if span[0] < at_s < span[1] else sample
    )


def on_flight(changes: Changes, events: Events) -> list[float]:
    """As :func:`on_trial`, of a flight with a truth."""
    flown = fly(events, changes)
    counted = flown.known & (flown.time_s >= FLIGHT_SETTLED_S)
    _, heading, inclination = rms(flown.errors_deg[counted])
    under = flown.errors_deg[counted][:, [2, 1]] <= flown.sigma_deg[counted]
    return [inclination, heading, *under.mean(axis=0).tolist(), np.nan, np.nan]


def unaided(changes: Changes, events: Events) -> list[float]:
    aiding = {**changes.get("aiding", {}), **UNAIDED["aiding"]}
    return on_flight({**changes, "aiding": aiding}, events)


def keys(only: Sequence[str]) -> Iterator[Question]:
    """Every number of the profile's sections, and every switch that is on."""
    profile = profile_to_json(load_profile("imu"))
    for section in SECTIONS:
        for name, value in profile[section].items():
            if only and name not in only:
                continue
            if value is True and name.startswith("use_"):
                yield Question(name, "off", {section: {name: False}})
            elif not isinstance(value, bool) and isinstance(value, int | float) and value:
                for factor in FACTORS:
                    yield Question(name, f"x{factor:g}", {section: {name: factor * value}})


def answer(question: Question) -> dict[str, list[float]]:
    """The scores of every set with that change; a profile that is refused has none."""
    try:
        merge_profile(load_profile("imu"), question.profile)
        return {name: score(question.profile) for name, score in SCORES.items()}
    except InputError:
        return {}


SCORES: dict[str, Score] = {}  # of a process
OWN_HEADING: set[str] = set()  # recordings whose reference has a heading of its own


def prepare(options: Namespace) -> None:
    """Read the data, once a process."""
    folders = chosen_sets(options)
    OWN_HEADING.update(t.name for name in options.own_heading for t in folders[name])
    if options.seconds:
        folders = {
            name: [t.cut(slice(0, round(options.seconds * t.rate_hz))) for t in trials]
            for name, trials in folders.items()
        }
    flown = {"logs": [read(path) for path in options.logs]} if options.logs else {}
    if options.flights:
        for name, case in (("50 Hz", "sound"), ("4 Hz", "4 Hz")):
            flown[f"flights at {name}"] = [
                recorded(case, motion, seed, DURATION_S)
                for motion in CASES[case].motions
                for seed in options.flights
            ]
    SCORES.update(scores(folders, flown))


def moved(base: dict[str, list[float]], found: dict[str, list[float]]) -> Row:
    """The largest changes, and where."""
    error, coverage = (0.0, "-"), (0.0, "-")
    for name, figures in found.items():
        for now, before in zip(figures[:2], base[name][:2], strict=True):
            share = (now - before) / max(before, LEAST_DEG)
            error = max(error, (share, name), key=lambda each: abs(each[0]))
        for now, before in zip(figures[2:], base[name][2:], strict=True):
            coverage = max(coverage, (now - before, name), key=lambda each: abs(each[0]))
    return {
        "error %": 100.0 * error[0],
        "on": error[1],
        "coverage": coverage[0],
        "on ": coverage[1],
    }


def moves(row: Row) -> bool:
    """Whether it is worth a number."""
    return abs(row["error %"]) > 100.0 * LEAST_SHARE or abs(row["coverage"]) > LEAST_COVERAGE


def tables(options: Namespace) -> Tables:
    if options.own_heading:
        options.own_heading = names([each.name for each in options.folders], options.own_heading)
    asked = list(keys(options.only))[: 2 if options.smoke else None]
    with ProcessPoolExecutor(options.jobs, initializer=prepare, initargs=(options,)) as pool:
        base = pool.submit(answer, Question("", "", {})).result()
        answers = pool.map(answer, asked)
        rows: list[Row] = []
        for question, found in zip(
            asked, track(answers, total=len(asked), console=Console(stderr=True)), strict=True
        ):
            head = {"number": question.name, "change": question.change}
            rows.append({**head, **moved(base, found)} if found else {**head, "error %": None})
    still = {row["number"] for row in rows} - {
        row["number"] for row in rows if row["error %"] is None or moves(row)
    }
    rows.sort(key=lambda row: -abs(row["error %"] or 0.0))
    nothing = [{"n": len(still), "names": sorted(still)}]
    return {"what a number moves": rows, "move nothing": nothing}


main = benchmark(
    __doc__,
    tables,
    *FOLDERS,
    option("--logs", type=Path, nargs="*", default=[], help="with a truth"),
    option("--flights", type=seeds, default=(), metavar="A-B", help="seeds of these"),
    option("--own-heading", default="", metavar="NAME,NAME", help="folders without true north"),
    option("--only", type=lambda text: text.split(","), default=[], metavar="NAME,NAME"),
    option("--seconds", type=float, default=0.0, help="of each recording; 0: all"),
    option("--jobs", type=int, default=2),
)

if __name__ == "__main__":
    sys.exit(main())
