"""From the options of ``fuzzbee tune`` to a plan of the search; all checks come before any work."""

import os
from pathlib import Path
from typing import Any, NamedTuple

from estimator.errors import InputError
from estimator.profile import SHIPPED, Profile, load_profile, merge_profile
from fuzzbee.options import require_extra, seed_range
from fuzzbee.say import tell
from fuzzbee.time_window import time_window
from fuzzbee.tune.read_flight import REFERENCES, read_flight
from fuzzbee.tune.request import SIMULATION, TuneRequest
from fuzzbee.version import __version__
from tuning.flight import BETTER_LOG, Flight, Part, require_substance
from tuning.log_task import GOALS, MEMBERSHIP_RATE_HZ, LogTask, Split, default_groups, split
from tuning.paper_task import FIRST_RESERVED_SEED, PaperTask, midpoint_profile
from tuning.recovery import require_recoveries
from tuning.search import ALGORITHMS, SearchOptions

MIDPOINT = "midpoint"
DEFAULT_NOISE_SEEDS = "100-107"
DEFAULT_HELD_OUT_SEEDS = "200-219"
# SciPy's differential evolution mixes three other members with two more.
FEWEST_SOURCES = {"abc": 2, "cmaes": 1, "de": 5, "random": 1}


class Plan(NamedTuple):
    """What is searched, and what goes into the file's provenance.

    ``identity`` is everything that determines the result, as plain JSON values.
    ``reference`` says what the cost is measured against.
    """

    task: PaperTask | LogTask
    options: SearchOptions
    output: Path
    identity: dict[str, Any]
    inputs: list[dict[str, str]]
    reference: str


def plan(request: TuneRequest) -> Plan:
    """Check everything and prepare the search; says what each log is for.

    Raises:
        InputError: options that are infeasible, empty or contradict each other,
            and sources that cannot be used.
    """
    _require_numbers(request)
    _require_output(request)
    return _simulation_plan(request) if request.is_simulated else _log_plan(request)


def _simulation_plan(request: TuneRequest) -> Plan:
    if len(request.sources) > 1 or request.held_out:
        raise InputError("tune: sim: stands alone, not beside logs")
    if request.objective is not None:
        raise InputError("--objective goes with logs only; sim: has the paper's J")
    if request.reference is not None:
        raise InputError("--reference goes with logs only; sim: has the truth")
    for name, given in (("--from", request.begin), ("--to", request.end)):
        if given is not None:
            raise InputError(f"{name} goes with logs only; sim: flies 15 s")
    noise = _seeds("--noise-seeds", request.noise_seeds or DEFAULT_NOISE_SEEDS)
    held_out = _seeds("--held-out-seeds", request.held_out_seeds or DEFAULT_HELD_OUT_SEEDS)
    common = sorted({*noise} & {*held_out})
    if common:
        raise InputError(
            f"--held-out-seeds: seed {common[0]} is also in --noise-seeds; unseen seeds are needed"
        )
    base = midpoint_profile() if request.base is None else load_profile(request.base)
    groups = _groups(request, ("membership",))
    if "membership" not in groups:
        raise InputError(
            f"--parameters {request.parameters}: sim: is tuned on membership, or membership,filter"
        )
    task = PaperTask(base, groups, tuple(noise), tuple(held_out))
    seeds = {"noise": _seeds_text(noise), "held_out": _seeds_text(held_out)}
    return _plan(request, task, [{"name": SIMULATION}], "simulated vehicle's truth", seeds)


def _log_plan(request: TuneRequest) -> Plan:
    for option, value in (
        ("--noise-seeds", request.noise_seeds),
        ("--held-out-seeds", request.held_out_seeds),
    ):
        if value is not None:
            raise InputError(f"{option} goes with sim: only; a log has its own noise")
    goal = request.objective or "flight"
    if goal not in GOALS:
        raise InputError(f"--objective {goal}: unknown; choose from {', '.join(GOALS)}")
    if request.reference not in (None, *REFERENCES):
        raise InputError(
            f"--reference {request.reference}: unknown; choose from {', '.join(REFERENCES)}"
        )
    base = load_profile(request.base or "imu")
    if not base.conditioned:
        raise InputError("base profile: logs are tuned with conditioning.enabled = true")
    flights, held_out = _read_flights(request, base)
    slowest = min(flights, key=lambda flight: flight.rate_hz)
    groups = _groups(request, default_groups(goal, slowest.rate_hz))
    if ("sigma" in groups) != (goal == "coverage"):
        raise InputError("--parameters sigma and --objective coverage go with each other only")
    _require_rate(request, groups, slowest)
    base = _with_tuned_gain(base, groups)
    chosen = split(flights, held_out)
    _require_references(goal, chosen)
    for flight in flights:
        tell(
            f"{flight.name}: {flight.message} at {flight.rate_hz:.1f} Hz, "
            f"reference: {_reference_text(flight)}, {_use(chosen, flight)}"
        )
    inputs = [
        {"name": flight.name, "sha256": flight.sha256, "use": _use(chosen, flight)}
        for flight in flights
    ]
    reference = "; ".join(dict.fromkeys(_reference_text(flight) for flight in flights))
    return _plan(request, LogTask(base, groups, chosen, goal), inputs, reference, {})


def _with_tuned_gain(base: Profile, groups: tuple[str, ...]) -> Profile:
    """The profile with the gain that the tuned numbers belong to: others would move nothing."""
    wanted = "fuzzy" if {"membership", "filter"} & {*groups} else base.filter.gain
    if "gain" in groups and wanted != "fuzzy":
        wanted = "fixed"
    if wanted == base.filter.gain:
        return base
    tell(f'the numbers of that gain are tuned: the result has filter.gain = "{wanted}"')
    return merge_profile(base, {"filter": {"gain": wanted}})


def _plan(
    request: TuneRequest,
    task: PaperTask | LogTask,
    inputs: list[dict[str, str]],
    reference: str,
    seeds: dict[str, str],
) -> Plan:
    """The plan; in its identity, what was left to a default counts as if it had been given."""
    sources, cycles = request.budget
    limit = sources * task.space.dimensions if request.limit is None else request.limit
    search = SearchOptions(request.algorithm, sources, cycles, limit, request.seed)
    options: dict[str, Any] = {
        "command": "tune",
        "algorithm": request.algorithm,
        "sources": sources,
        "cycles": cycles,
        "parameters": ",".join(task.groups),
        "base": _base_identity(request, task.base),
    }
    if request.algorithm == "abc":
        options["limit"] = limit
    if isinstance(task, LogTask):
        options["objective"] = task.goal
    if request.reference is not None:
        options["reference"] = request.reference
    begin, end = time_window(request.begin, request.end)
    options |= {name: at for name, at in (("from", begin), ("to", end)) if at is not None}
    identity = {
        "options": options,
        "inputs": inputs,
        "seeds": {"search": request.seed, **seeds},
        "version": __version__,
    }
    return Plan(task, search, request.output, identity, inputs, reference)


def _read_flights(request: TuneRequest, base: Profile) -> tuple[tuple[Flight, ...], frozenset[str]]:
    """All flights in the order given, and the SHA-256 of those that are asked to be held out.

    A log that is held out may stand among the sources, too.
    """
    paths = _log_paths(request)
    apart = {path.resolve() for path in request.held_out}
    searched = [path for path in paths if path.resolve() not in apart]
    if not searched:
        raise InputError("--hold-out: nothing is left to tune on")
    chosen = request.reference, time_window(request.begin, request.end)
    flights = tuple(read_flight(path, base, *chosen) for path in (*searched, *request.held_out))
    for flight in flights:
        require_substance(flight)
    _require_distinct(flights)
    return flights, frozenset(flight.sha256 for flight in flights[len(searched) :])


def _require_rate(request: TuneRequest, groups: tuple[str, ...], slowest: Flight) -> None:
    if slowest.rate_hz < MEMBERSHIP_RATE_HZ and {"membership", "filter"} & {*groups}:
        raise InputError(
            f"--parameters {request.parameters}: {slowest.name} has IMU data at "
            f"{slowest.rate_hz:.1f} Hz; the fuzzy controller is tuned from "
            f"{MEMBERSHIP_RATE_HZ:g} Hz on ({BETTER_LOG})"
        )


def _require_references(goal: str, chosen: Split) -> None:
    """Refuse a part that has nothing to be scored by."""
    for part in (*chosen.tuning, *chosen.held_out):
        flight = part.flight
        if flight.reference == "none":
            if goal == "recovery":
                raise InputError(f"{flight.name}: --objective recovery needs a reference attitude")
        elif not flight.known[part.window].any():
            raise InputError(f"{flight.name}: no reference attitude where it would be scored")
        elif goal == "recovery":
            require_recoveries(part)


def _use(chosen: Split, flight: Flight) -> str:
    """What a flight is for."""

    def has(parts: tuple[Part, ...]) -> bool:
        return any(part.flight is flight for part in parts)

    if has(chosen.tuning) and has(chosen.held_out):
        return "its later part held out"
    return "tuned on" if has(chosen.tuning) else "held out"


def _reference_text(log: Flight) -> str:
    """What the cost of a log is measured against."""
    name = {
        "sim": "simulator's truth",
        "autopilot": "autopilot's attitude",
        "smooth": "attitude smoothed over the whole log",
        "none": "prediction of its own vectors, without a reference",
    }[log.reference]
    return name if log.has_field or log.reference == "none" else f"{name}, inclination only"


def _log_paths(request: TuneRequest) -> list[Path]:
    paths = [Path(source) for source in request.sources]
    for path in (*paths, *request.held_out):
        if not path.exists():
            raise InputError(f"{path}: no such file")
    return paths


def _require_distinct(logs: tuple[Flight, ...]) -> None:
    """Refuse a log that is given twice: it would count twice."""
    seen: dict[str, str] = {}
    for log in logs:
        if log.sha256 in seen:
            raise InputError(f"{log.name}: the same log as {seen[log.sha256]}")
        seen[log.sha256] = log.name


def _seeds(option: str, text: str) -> range:
    """``A-B``, both included, or a single ``A``, below the reserved seeds."""
    chosen = seed_range(text, option)
    if chosen[-1] >= FIRST_RESERVED_SEED:
        raise InputError(
            f"{option} {text}: seeds from {FIRST_RESERVED_SEED} on are kept for judging results"
        )
    return chosen


def _seeds_text(chosen: range) -> str:
    return str(chosen[0]) if len(chosen) == 1 else f"{chosen[0]}-{chosen[-1]}"


def _require_numbers(request: TuneRequest) -> None:
    if request.algorithm not in ALGORITHMS:
        raise InputError(
            f"--algorithm {request.algorithm}: unknown; choose from {', '.join(ALGORITHMS)}"
        )
    if request.algorithm == "cmaes":
        require_extra("cmaes", "--algorithm cmaes", "optimizers")
    fewest = FEWEST_SOURCES[request.algorithm]
    sources, cycles = request.budget
    if sources < fewest:
        raise InputError(f"--sources {sources}: {request.algorithm} needs at least {fewest}")
    if cycles < 1:
        raise InputError(f"--cycles {cycles}: at least 1 is needed")
    if request.limit is not None and request.limit < 1:
        raise InputError(f"--limit {request.limit}: at least 1 is needed")
    if request.limit is not None and request.algorithm != "abc":
        raise InputError(f"--limit is the bees' own; {request.algorithm} has none")
    if request.seed < 0:
        raise InputError(f"--seed {request.seed}: must be 0 or more")


def _require_output(request: TuneRequest) -> None:
    """Refuse, before the search, an output that could not be written after it."""
    output = request.output
    if output.is_dir():
        raise InputError(f"-o {output}: a folder, not a file")
    if not output.parent.is_dir():
        raise InputError(f"-o {output}: no such folder: {output.parent}")
    if not os.access(output.parent, os.W_OK):
        raise InputError(f"-o {output}: the folder cannot be written to")


def _groups(request: TuneRequest, default: tuple[str, ...]) -> tuple[str, ...]:
    if request.parameters is None:
        return default
    return tuple(name.strip() for name in request.parameters.split(",") if name.strip())


def _base_identity(request: TuneRequest, base: Profile) -> str:
    """The base's name; for a file the SHA-256 of what it says, which its name does not fix."""
    from hashlib import sha256

    from estimator.profile import profile_to_toml

    name = request.base or (MIDPOINT if request.is_simulated else "imu")
    if name in (*SHIPPED, MIDPOINT):
        return name
    return f"sha256:{sha256(profile_to_toml(base).encode()).hexdigest()}"
