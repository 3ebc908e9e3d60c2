"""What does each tuned number of the profile ``imu`` move?

    python benchmarks/sensitivity.py [DIR ...] [--seeds 100-101] [--only NAME,NAME]

Each number of conditioning and aiding that is not 0 is multiplied by 0.7 and by 1.4. A row a
change: the largest change of a set's mean error (percent of it, at least 0.3 deg), the largest
change of its share under sigma, and the sets on which they are. Sets are the folders' recordings as
they are, with the gyroscope cut, with passing magnets, and turned unseen in the middle; and flights
in simulation: sound ones and at 4 Hz, each with velocity, without, and turned unseen at a minute,
with a bad compass, and with satellites lost or wrong. A change that a bound refuses has none. The
last row counts the numbers that move no error by 1 % and no share by 0.02.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from accuracy import worse
from common.filters import Filter, Output, fuzzbee, run_whole
from common.recordings import Trial, chosen_sets
from common.report import FOLDERS, Row, Tables, benchmark, names, option, seeds
from common.scores import mean_of
from common.scores import score as score_trial
from flying.cases import CASES, SKIP_S, recorded
from flying.replayed import UNAIDED, Events, changed, fly
from flying.replayed import score as score_flight
from rich.console import Console
from rich.progress import track

from drivers.events import Imu
from estimator.errors import InputError
from estimator.geometry.quaternion import exp, rotate
from estimator.profile import load_profile, merge_profile, profile_to_json
from estimator.types import ImuSample

SECTIONS = ("conditioning", "aiding")
FACTORS = (0.7, 1.4)
WAYS = ("as recorded", "gyroscope cut", "magnets pass")
CASES_FLOWN = ("sound", "4 Hz", "compass", "satellites")  # of flights, most of them at 50 Hz
TURNED_AT_S, TURNED = 60.0, exp((1.0, 0.0, 0.5))  # an unsensed turn, by 64 deg
LEAST_DEG, LEAST_PERCENT, LEAST_SHARE = 0.3, 1.0, 0.02
ERRORS = ("inclination", "heading")
SHARES = ("under sigma", "under sigma in motion", "under sigma at rest")

Changes = dict[str, Any]
Score = Callable[[Changes], Row]
Runner = Callable[[Filter, Trial], Output]
SETS: dict[str, Score] = {}  # of a process


def read(options: Namespace) -> None:
    """Read the recordings and fly the flights, once a process."""
    trials = chosen_sets(options) if options.folders or options.smoke else {}
    for folder, recordings in trials.items():
        for way in WAYS:
            SETS[f"{folder}, {way}"] = partial(on_trials, worse(recordings, way, 0), run_whole)
        SETS[f"{folder}, turned unseen"] = partial(on_trials, recordings, run_turned)
    for case in () if options.smoke else CASES_FLOWN:
        motions = CASES[case].motions
        flights = [recorded(case, motion, k) for motion in motions for k in options.seeds]
        SETS[f"flights, {case}"] = partial(on_flights, flights, SKIP_S)
        if case in ("sound", "4 Hz"):
            SETS[f"flights, {case}, no velocity"] = partial(without_velocity, flights)
            turned = [turned_unseen(events) for events in flights]
            SETS[f"flights, {case}, turned unseen"] = partial(on_flights, turned, TURNED_AT_S)


def run_turned(filter_: Filter, trial: Trial) -> Output:
    """The filter on a recording whose sensors have missed a turn in the middle."""
    run, middle = filter_(trial), len(trial.moving) // 2
    before = run.advance(slice(0, middle))
    run.turn(np.array(TURNED))
    parts = zip(before, run.advance(slice(middle, None)), strict=True)
    return Output(*map(np.concatenate, parts))


def turned_unseen(events: Events) -> Events:
    """A flight whose IMU is turned in the vehicle until ``TURNED_AT_S``."""
    first_us = next(event.sample.time_us for event in events if isinstance(event, Imu))

    def turn(sample: ImuSample) -> ImuSample:
        if sample.time_us - first_us > 1e6 * TURNED_AT_S:
            return sample
        gyr, acc, mag = (rotate(TURNED, vector) for vector in sample[1:4])
        return sample._replace(gyr_rad_s=gyr, acc_m_s2=acc, mag_gauss=mag)

    return changed(events, turn)


def on_trials(trials: list[Trial], run: Runner, changes: Changes) -> Row:
    """Mean scores on recordings with a changed profile."""
    return mean_of([score_trial(each, *run(fuzzbee(changes), each)) for each in trials])


def on_flights(flights: list[Events], skip_s: float, changes: Changes) -> Row:
    """Mean scores on flights."""
    return mean_of([score_flight(fly(events, changes), skip_s) for events in flights])


def without_velocity(flights: list[Events], changes: Changes) -> Row:
    """The same, of attitudes that no velocity helps."""
    aiding = {**changes.get("aiding", {}), **UNAIDED["aiding"]}
    return on_flights(flights, SKIP_S, {**changes, "aiding": aiding})


def changes_of(only: str) -> Iterator[tuple[str, float, Changes]]:
    """Every number's name, factor, and what they make of the profile."""
    profile = profile_to_json(load_profile("imu"))
    known = {name: section for section in SECTIONS for name in profile[section]}
    for name in names(known, only) if only else known:
        value = profile[known[name]][name]
        if isinstance(value, int | float) and not isinstance(value, bool) and value:
            for factor in FACTORS:
                yield name, factor, {known[name]: {name: factor * value}}


def answer(changes: Changes) -> dict[str, Row] | None:
    """The scores of every set; None if a bound refuses the number."""
    try:
        merge_profile(load_profile("imu"), changes)
    except InputError:
        return None
    return {name: of(changes) for name, of in SETS.items()}


def moved(base: Mapping[str, Row], found: Mapping[str, Row]) -> Row:
    """The largest changes, and where."""
    errors, shares = [(0.0, "-")], [(0.0, "-")]
    for name, now in found.items():
        before = base[name]
        for error in ERRORS:
            by = 100.0 * (now[error] - before[error]) / max(before[error], LEAST_DEG)
            errors.append((by, f"{error}, {name}"))
        for share in SHARES:
            pairs = zip(now.get(share) or (), before.get(share) or (), ERRORS, strict=False)
            shares += [(now_ - before_, f"{of}, {name}") for now_, before_, of in pairs]
    (error, on_error), (share, on_share) = (
        max(e, key=lambda x: abs(x[0])) for e in (errors, shares)
    )
    return {"error %": error, "error of": on_error, "under sigma": share, "share of": on_share}


@benchmark(
    *FOLDERS,
    option("--seeds", type=seeds, default=range(100, 102), metavar="A-B", help="of the flights"),
    option("--only", default="", metavar="NAME,NAME", help="these numbers"),
    option("--jobs", type=int, default=2, help="processes"),
)
def main(options: Namespace) -> Tables:
    if options.folders:
        chosen_sets(options)  # refuses folders without recordings, in this process
    asked = list(changes_of(options.only))[: 2 if options.smoke else None]
    rows: list[Row] = []
    still: dict[str, bool] = {}
    with ProcessPoolExecutor(options.jobs, initializer=read, initargs=(options,)) as pool:
        base = pool.submit(answer, {}).result()
        answers = pool.map(answer, [changes for _, _, changes in asked])
        bar = track(answers, total=len(asked), console=Console(stderr=True))
        for (name, factor, _), found in zip(asked, bar, strict=True):
            if found is None:
                rows.append({"number": name, "times": factor, "error of": "refused"})
                continue
            row = {"number": name, "times": factor, **moved(base, found)}
            far = abs(row["error %"]) >= LEAST_PERCENT or abs(row["under sigma"]) >= LEAST_SHARE
            still[name] = still.get(name, True) and not far
            rows.append(row)
    rows.sort(key=lambda row: -abs(row.get("error %", 0.0)))
    quiet = sorted(name for name, is_still in still.items() if is_still)
    return {"what a number moves": rows, "move nothing": [{"numbers": len(quiet), "names": quiet}]}
