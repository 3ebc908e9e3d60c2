"""What is tuning on flights worth, by what it is measured against?

    python benchmarks/tuned.py [--seed 900] [--sources 6] [--cycles 8]

Five simulated vehicles (flying/cases.py) of four flights each: one is searched on, one is held out
for the guards of ``fuzzbee tune``, two are judged against the truth. A row a vehicle and way:
``shipped``; tuned by the ``autopilot``'s attitude, by the ``smooth``ed one, by the ``truth`` that
no recorded flight has; ``random`` search by the smoothed one, on the same budget. Degrees
RMS and shares of errors under sigma from 40 s on, means of both flights; ``written`` is whether the
guards let the profile pass, so that with ``no`` the shipped one goes on. The autopilot's attitude
is the truth turned: 0.4 deg of slow noise and 0.3 deg of trim on each axis of the tilt, a heading
that is off by 1.5 deg all the time and by 0.8 deg of slow noise.
"""

import sys
from argparse import Namespace

import numpy as np
from common.report import Row, Tables, benchmark, option
from flying.cases import SKIP_S, written
from scipy.signal import lfilter

from estimator.geometry.rotations import exp, multiply
from estimator.profile import Profile, load_profile
from fuzzbee.tune.read_flight import read_flight
from fuzzbee.tune.report import has_gained
from tuning.flight import Flight, sure_flight
from tuning.flight_cost import harm, measure
from tuning.optimizers import run_search
from tuning.search import Search, SearchOptions
from tuning.space import encode, profile_with, values_of
from tuning.task import Task

VEHICLES = (
    ("noisy", "plane"),
    ("vibration", "copter"),
    ("compass", "calm copter"),
    ("slow filters", "rover"),
    ("cabin", "car"),
)
JUDGED = 2
FLIGHT_S = 160.0
SLOW_DEG, ALWAYS_DEG, TAU_S = (0.4, 0.4, 0.8), (0.3, 0.3, 1.5), 20.0
BASE = load_profile("imu")


def flown(case: str, motion: str, seed: int, duration_s: float) -> Flight:
    """A flight with its truth."""
    with written(case, motion, seed, duration_s) as path:
        return read_flight(path, BASE)


def by_autopilot(flight: Flight, seed: int) -> Flight:
    """The flight beside what an autopilot's filter would report."""
    rng, n = np.random.default_rng([88, seed]), len(flight.truth)
    keep = np.exp(-1.0 / (flight.rate_hz * TAU_S))
    slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal((n, 3)), axis=0)
    off_deg = np.array(SLOW_DEG) * slow + np.array(ALWAYS_DEG) * rng.standard_normal(3)
    return flight._replace(
        reference="autopilot", truth=multiply(exp(np.radians(off_deg)), flight.truth)
    )


def whole(flight: Flight) -> Flight:
    """All of it but its start."""
    return flight._replace(first=int(np.searchsorted(flight.time_s, SKIP_S)))


def tuned(searched: Flight, held_out: Flight, options: SearchOptions) -> tuple[Profile, bool]:
    """What a search finds on one flight, and whether ``fuzzbee tune`` would write it."""
    task = Task(BASE, ("noise",), (whole(searched),), (whole(held_out),))
    search = Search(task.space, options, task.costs)
    run_search(search, encode(task.space, values_of(task.space, BASE)))
    found = profile_with(task.space, BASE, search.best_values)
    before, after = ([measure(p, each) for each in task.held_out] for p in (BASE, found))
    scores = (task.score(profile)["held_out"] for profile in (BASE, found))
    return found, has_gained(*scores, harm(before, after))


def judged(profile: Profile, flights: list[Flight]) -> Row:
    """Means over flights with truth."""
    figures = [measure(profile, whole(flight)) for flight in flights]
    angles = {
        "inclination": [f.inclination for f in figures],
        "heading": [f.heading for f in figures if f.heading],
    }
    means = {name: float(np.mean([f.rms_deg for f in some])) for name, some in angles.items()}
    shares = [float(np.mean([f.coverage for f in some])) for some in angles.values()]
    return {**means, "under sigma": shares}


def of_vehicle(
    case: str, motion: str, options: SearchOptions, seeds: range, length_s: float
) -> list[Row]:
    """The rows of one vehicle."""
    flights = [flown(case, motion, seed, length_s) for seed in seeds]
    pair, others = flights[:2], flights[2:]
    smooth = [sure_flight(flight, BASE, is_wanted=False) for flight in pair]
    reported = [by_autopilot(f, seed) for f, seed in zip(pair, seeds, strict=False)]
    by = {
        "autopilot": (reported, options),
        "smooth": (smooth, options),
        "truth": (pair, options),
        "random": (smooth, options._replace(algorithm="random")),
    }
    rows = [{"way": "shipped", "written": "-", **judged(BASE, others)}]
    for way, (two, how) in by.items():
        is_sure = all(flight.reference == "smooth" for flight in smooth)
        if way in ("smooth", "random") and not is_sure:
            rows.append({"way": way, "written": "not sure"})
            continue
        profile, is_written = tuned(*two, how)
        written = "yes" if is_written else "no"
        rows.append({"way": way, "written": written, **judged(profile, others)})
    return [{"vehicle": f"{motion}, {case}", **row} for row in rows]


@benchmark(
    option("--seed", type=int, default=900, help="of the first flight"),
    option("--sources", type=int, default=6),
    option("--cycles", type=int, default=8),
)
def main(options: Namespace) -> Tables:
    vehicles, length_s = VEHICLES, FLIGHT_S
    seeds = range(options.seed, options.seed + 2 + JUDGED)
    if options.smoke:
        vehicles, length_s, seeds = VEHICLES[3:4], 60.0, seeds[:3]
        options.sources, options.cycles = 2, 1
    budget = SearchOptions("abc", options.sources, options.cycles, 48, seed=0)
    rows = []
    for case, motion in vehicles:
        print(f"{motion}, {case} ...", file=sys.stderr, flush=True)
        rows += of_vehicle(case, motion, budget, seeds, length_s)
    return {"profiles on flights that they were not tuned on": rows}
