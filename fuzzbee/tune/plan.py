"""From the options of ``fuzzbee tune`` to a plan of the search; all checks come before any work."""

import os
from collections.abc import Collection
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from drivers.logs.time_window import TimeWindow
from estimator.calibration import PLAIN, Calibration
from estimator.errors import InputError
from estimator.profile import (
    SHIPPED,
    Profile,
    Provenance,
    load_profile,
    merge_profile,
    profile_to_toml,
)
from fuzzbee.notify import notify, print_line
from fuzzbee.options import SIMULATION, asked_for, require_extra, seed_range, time_window
from fuzzbee.tune.command import TuneRequest
from fuzzbee.tune.read_flight import REFERENCES, read_flight, reference_text
from fuzzbee.version import __version__
from tuning import task as tasks
from tuning.flight import BETTER_LOG, Flight, require_substance
from tuning.optimizers import ALGORITHMS
from tuning.recovery import recoveries
from tuning.search import SearchOptions

MIDPOINT = "midpoint"
CALIBRATION = "calibration"  # the group of parameters that begins with a fit
CONTROLLER = {"membership", "filter"}  # the groups of the fuzzy controller
# Food sources and cycles. A flight flown again takes a tenth of a second, the signals 50 us.
SIMULATION_BUDGET, LOG_BUDGET = (100, 300), (10, 15)
# What is searched, the profile to beat, the reference of the cost, and the inputs
Found = tuple[tasks.Task, Profile, str, Provenance]


class Plan(NamedTuple):
    """What is searched and how."""

    request: TuneRequest
    task: tasks.Task
    before: Profile  # which the result is to beat
    options: SearchOptions
    reference: str  # of the cost
    provenance: Provenance  # all that determines the result: options, inputs, seeds and version


def plan(request: TuneRequest) -> Plan:
    """Check everything and prepare the search; prints what each log is for."""
    options, output = _search_options(request), request.output
    if output.is_dir():
        raise InputError(f"-o {output}: a folder, not a file")
    if not os.access(output.parent, os.W_OK):
        raise InputError(f"-o {output}: the folder cannot be written to")
    task, before, reference, provenance = (_paper if request.is_simulated else _logs)(request)
    if request.limit is None:
        options = options._replace(limit=options.food_sources * len(task.space))
    given = _given(request, task, before, options)
    provenance = replace(provenance, options=given, version=__version__)
    return Plan(request, task, before, options, reference, provenance)


def _given(
    request: TuneRequest, task: tasks.Task, before: Profile, search: SearchOptions
) -> dict[str, Any]:
    """The options that determine the result; a base that is no name by its content."""
    begin, end = time_window(request.begin, request.end)
    base = request.base or (MIDPOINT if request.is_simulated else "imu")
    if base not in (*SHIPPED, MIDPOINT):  # a file's name does not fix its content
        base = f"sha256:{sha256(profile_to_toml(before).encode()).hexdigest()}"
    given = {
        "command": "tune",
        "algorithm": search.algorithm,
        "sources": search.food_sources,
        "cycles": search.cycles,
        "parameters": ",".join(task.groups),
        "base": base,
        "limit": search.limit if search.algorithm == "abc" else None,
        "objective": None if request.is_simulated else task.goal,
        "reference": request.reference,
        "from": begin,
        "to": end,
    }
    return {name: value for name, value in given.items() if value is not None}


def _search_options(request: TuneRequest) -> SearchOptions:
    """Those of the search, checked; a limit that was not given is still 0."""
    algorithm, limit = request.algorithm, request.limit
    sources, cycles = SIMULATION_BUDGET if request.is_simulated else LOG_BUDGET
    sources = sources if request.food_sources is None else request.food_sources
    cycles = cycles if request.cycles is None else request.cycles
    _require_known("--algorithm", algorithm, ALGORITHMS)
    if algorithm == "cmaes":
        require_extra("cmaes", "--algorithm cmaes", "optimizers")
    fewest = ALGORITHMS[algorithm].fewest_sources
    if sources < fewest:
        raise InputError(f"--sources {sources}: {algorithm} needs at least {fewest}")
    if limit is not None and algorithm != "abc":
        raise InputError(f"--limit is the bees' own; {algorithm} has none")
    for option, number, least in (
        ("--cycles", cycles, 1),
        ("--limit", limit, 1),
        ("--threads", request.threads, 1),
        ("--seed", request.seed, 0),
    ):
        if number is not None and number < least:
            raise InputError(f"{option} {number}: must be {least} or more")
    return SearchOptions(algorithm, sources, cycles, limit or 0, request.seed)


def _require_known(option: str, word: str | None, known: Collection[str]) -> None:
    if word is not None and word not in known:
        raise InputError(f"{option} {word}: unknown; choose from {', '.join(known)}")


def _groups(request: TuneRequest, default: tuple[str, ...]) -> tuple[str, ...]:
    if request.parameters is None:
        return default
    return tuple(name.strip() for name in request.parameters.split(",") if name.strip())


def _paper(request: TuneRequest) -> Found:
    if len(request.sources) > 1 or request.hold_out:
        raise InputError("tune: sim: stands alone, not beside logs")
    for flag in asked_for(request, "objective", "reference", "begin", "end"):
        raise InputError(f"{flag} goes with logs only; sim: has the paper's 15 s, truth and J")
    noise = _seeds("--noise-seeds", request.noise_seeds or "100-107")
    held_out = _seeds("--held-out-seeds", request.held_out_seeds or "200-219")
    if both := sorted({*noise} & {*held_out}):
        raise InputError(
            f"--held-out-seeds: seed {both[0]} is also in --noise-seeds; unseen seeds are needed"
        )
    base = tasks.midpoint_profile() if request.base is None else load_profile(request.base)
    groups = _groups(request, ("membership",))
    if "membership" not in groups:
        raise InputError(
            f"--parameters {request.parameters}: sim: is tuned on membership, or membership,filter"
        )
    task = tasks.PaperTask(base, groups, tuple(noise), tuple(held_out))
    seeds = {"search": request.seed, "noise": _in_words(noise), "held_out": _in_words(held_out)}
    provenance = Provenance(inputs=[{"name": SIMULATION}], seeds=seeds)
    return task, base, "simulated vehicle's truth", provenance


def _in_words(seeds: range) -> str:
    return f"{seeds[0]}-{seeds[-1]}" if len(seeds) > 1 else f"{seeds[0]}"


def _seeds(option: str, text: str) -> range:
    """``A-B``, both included, or a single ``A``, below the reserved seeds."""
    chosen = seed_range(text, option)
    if chosen[-1] >= tasks.FIRST_RESERVED_SEED:
        kept = f"seeds from {tasks.FIRST_RESERVED_SEED} on are kept for judging results"
        raise InputError(f"{option} {text}: {kept}")
    return chosen


def _logs(request: TuneRequest) -> Found:
    for flag in asked_for(request, "noise_seeds", "held_out_seeds"):
        raise InputError(f"{flag} goes with sim: only; a log has its own noise")
    goal = request.objective or "flight"
    _require_known("--objective", goal, tasks.GOALS)
    _require_known("--reference", request.reference, REFERENCES)
    base = load_profile(request.base or "imu")
    if not base.conditioned:
        raise InputError("base profile: logs are tuned with conditioning.enabled = true")
    calibrates = CALIBRATION in _groups(request, ())
    if calibrates and request.reference == "smooth":
        raise InputError(
            f"--reference smooth: not with --parameters {CALIBRATION}, which it would depend on"
        )
    plain = replace(base, calibration=PLAIN) if calibrates else base
    flights = _read_flights(request, plain, may_smooth=not calibrates)
    groups = _log_groups(request, goal, flights)
    named = frozenset(each.sha256 for each in flights if each.path in (request.hold_out or ()))
    searched, held_out = tasks.split(flights, named)
    for flight in (*searched, *held_out):
        if goal == "recovery":
            recoveries(flight)
        elif flight.reference != "none" and not flight.known[flight.window].any():
            raise InputError(f"{flight.name}: no reference attitude where it would be scored")
    start = before = _with_tuned_gain(base, groups)
    if calibrates:
        start = replace(start, calibration=_fitted(request, plain, searched))
    task = tasks.Task(start, groups, searched, held_out, goal)
    reference = "; ".join(dict.fromkeys(map(reference_text, flights)))
    inputs = _report_flights(flights, {flight.sha256 for flight in held_out})
    provenance = Provenance(inputs=inputs, seeds={"search": request.seed})
    return task, before, reference, provenance


def _report_flights(flights: tuple[Flight, ...], held_out: set[str]) -> list[dict[str, str]]:
    """Print what each flight is for, when all checks have passed; the same as the file has it."""
    inputs = []
    for flight in flights:
        if flight.refused is not None:
            notify(f"{flight.path}: {flight.refused}")
        use = "held out" if flight.sha256 in held_out else "tuned on"
        use = use if len(flights) > 1 else "its later part held out"
        rate = f"{flight.message} at {flight.rate_hz:.1f} Hz"
        print_line(f"{flight.name}: {rate}, reference: {reference_text(flight)}, {use}")
        inputs.append({"name": flight.name, "sha256": flight.sha256, "use": use})
    return inputs


def _read_flights(request: TuneRequest, base: Profile, *, may_smooth: bool) -> tuple[Flight, ...]:
    """All flights, those asked to be held out last, which may stand among the sources, too."""
    paths, held_out = [Path(source) for source in request.sources], request.hold_out or []
    for path in (*paths, *held_out):
        if not path.exists():
            raise InputError(f"{path}: no such file")
    apart = {path.resolve() for path in held_out}
    searched = [path for path in paths if path.resolve() not in apart]
    if not searched:
        raise InputError("--hold-out: nothing is left to tune on")
    window = time_window(request.begin, request.end)
    flights: dict[str, Flight] = {}
    for path in (*searched, *held_out):
        flight = read_flight(path, base, request.reference, window, may_smooth=may_smooth)
        require_substance(flight)
        same = flights.setdefault(flight.sha256, flight)
        if same is not flight:
            raise InputError(f"{flight.name}: the same log as {same.name}")
    return tuple(flights.values())


def _log_groups(request: TuneRequest, goal: str, flights: tuple[Flight, ...]) -> tuple[str, ...]:
    slowest = min(flights, key=lambda flight: flight.rate_hz)
    groups = _groups(request, tasks.default_groups(goal, slowest.rate_hz))
    if ("sigma" in groups) != (goal == "coverage"):
        raise InputError("--parameters sigma and --objective coverage go with each other only")
    if slowest.rate_hz < tasks.MEMBERSHIP_RATE_HZ and CONTROLLER & {*groups}:
        raise InputError(
            f"--parameters {request.parameters}: {slowest.name} has IMU data at "
            f"{slowest.rate_hz:.1f} Hz; the fuzzy controller is tuned from "
            f"{tasks.MEMBERSHIP_RATE_HZ:g} Hz on ({BETTER_LOG})"
        )
    return groups


def _with_tuned_gain(base: Profile, groups: tuple[str, ...]) -> Profile:
    """The profile with the gain that the tuned numbers belong to: others would move nothing."""
    wanted = "fixed" if "gain" in groups else base.filter.gain
    if CONTROLLER & {*groups}:
        wanted = "fuzzy"
    if base.filter.gain == wanted:
        return base
    print_line(f'the numbers of that gain are tuned: the result has filter.gain = "{wanted}"')
    return merge_profile(base, {"filter": {"gain": wanted}})


def _fitted(request: TuneRequest, plain: Profile, searched: tuple[Flight, ...]) -> Calibration:
    """What ``fuzzbee calibrate`` finds in what is searched on, and in nothing else."""
    from fuzzbee.calibration_report import report_calibration

    begin, end = time_window(request.begin, request.end)
    if (last := searched[0].last) is not None:  # the rest of the only one is held out
        end = searched[0].begin_s + float(searched[0].time_s[last])
    paths = [flight.path for flight in searched]
    report, _ = report_calibration(paths, plain, window=TimeWindow(begin, end))
    found: Calibration = report["calibration"]
    return found
