"""From the options of ``fuzzbee tune`` to a plan of the search; all checks come before any work."""

import os
from collections.abc import Collection
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from drivers.logs.time_window import TimeWindow
from estimator.calibration import Calibration
from estimator.errors import InputError
from estimator.profile import SHIPPED, Profile, load_profile, merge_profile, profile_to_toml
from fuzzbee.notify import notify, print_line
from fuzzbee.options import require_extra, seed_range, time_window
from fuzzbee.tune.command import SIMULATION, TuneRequest
from fuzzbee.tune.read_flight import REFERENCES, read_flight
from fuzzbee.version import __version__
from tuning.flight import BETTER_LOG, Flight, require_substance
from tuning.log_task import GOALS, MEMBERSHIP_RATE_HZ, LogTask, Split, default_groups, split
from tuning.optimizers import ALGORITHMS
from tuning.paper_task import FIRST_RESERVED_SEED, PaperTask, midpoint_profile
from tuning.recovery import recoveries
from tuning.search import SearchOptions

MIDPOINT = "midpoint"
CALIBRATION = "calibration"  # the group of parameters that begins with a fit
DEFAULT_NOISE_SEEDS = "100-107"
DEFAULT_HELD_OUT_SEEDS = "200-219"


class Plan(NamedTuple):
    """What is searched, and what goes into the file's provenance.

    ``identity`` is everything that determines the result, as plain JSON values.
    ``reference`` is what the cost is measured against.
    """

    task: PaperTask | LogTask
    options: SearchOptions
    identity: dict[str, Any]
    reference: str


def plan(request: TuneRequest) -> Plan:
    """Check everything and prepare the search; prints what each log is for."""
    _require_numbers(request)
    output = request.output
    if output.is_dir():
        raise InputError(f"-o {output}: a folder, not a file")
    if not os.access(output.parent, os.W_OK):
        raise InputError(f"-o {output}: the folder cannot be written to")
    return _simulation_plan(request) if request.is_simulated else _log_plan(request)


def _simulation_plan(request: TuneRequest) -> Plan:
    if len(request.sources) > 1 or request.held_out:
        raise InputError("tune: sim: stands alone, not beside logs")
    for name, given, instead in (
        ("--objective", request.objective, "has the paper's J"),
        ("--reference", request.reference, "has the truth"),
        ("--from", request.begin, "flies 15 s"),
        ("--to", request.end, "flies 15 s"),
    ):
        if given is not None:
            raise InputError(f"{name} goes with logs only; sim: {instead}")
    noise = _seeds("--noise-seeds", request.noise_seeds or DEFAULT_NOISE_SEEDS)
    held_out = _seeds("--held-out-seeds", request.held_out_seeds or DEFAULT_HELD_OUT_SEEDS)
    for seed in held_out:
        if seed in noise:
            raise InputError(
                f"--held-out-seeds: seed {seed} is also in --noise-seeds; unseen seeds are needed"
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
    for name, given in (
        ("--noise-seeds", request.noise_seeds),
        ("--held-out-seeds", request.held_out_seeds),
    ):
        if given is not None:
            raise InputError(f"{name} goes with sim: only; a log has its own noise")
    goal = request.objective or "flight"
    _require_known("--objective", goal, GOALS)
    _require_known("--reference", request.reference, (None, *REFERENCES))
    base = load_profile(request.base or "imu")
    if not base.conditioned:
        raise InputError("base profile: logs are tuned with conditioning.enabled = true")
    calibrates = CALIBRATION in _groups(request, ())
    if calibrates and request.reference == "smooth":
        raise InputError(
            f"--reference smooth: not with --parameters {CALIBRATION}, which it would depend on"
        )
    plain = msgspec.structs.replace(base, calibration=Calibration()) if calibrates else base
    refused: list[str] = []  # printed when all checks have passed: an error is one single line
    flights = _read_flights(request, plain, refused, may_smooth=not calibrates)
    slowest = min(flights, key=lambda flight: flight.rate_hz)
    groups = _groups(request, default_groups(goal, slowest.rate_hz))
    if ("sigma" in groups) != (goal == "coverage"):
        raise InputError("--parameters sigma and --objective coverage go with each other only")
    if slowest.rate_hz < MEMBERSHIP_RATE_HZ and {"membership", "filter"} & {*groups}:
        raise InputError(
            f"--parameters {request.parameters}: {slowest.name} has IMU data at "
            f"{slowest.rate_hz:.1f} Hz; the fuzzy controller is tuned from "
            f"{MEMBERSHIP_RATE_HZ:g} Hz on ({BETTER_LOG})"
        )
    apart = {path.resolve() for path in request.held_out}
    named = frozenset(flight.sha256 for flight in flights if flight.path.resolve() in apart)
    chosen = split(flights, named)
    _require_references(goal, chosen)
    start = before = _with_tuned_gain(base, groups)
    if calibrates:
        fitted = _fitted(request, plain, chosen)
        start = msgspec.structs.replace(start, calibration=fitted)
    task = LogTask(start, groups, chosen, goal, before if calibrates else None)
    for line in refused:
        notify(line)
    inputs = []
    for flight in flights:
        is_searched, is_held_out = (any(p.flight is flight for p in parts) for parts in chosen)
        use = "tuned on" if is_searched else "held out"
        if is_searched and is_held_out:
            use = "its later part held out"
        reference = _reference_text(flight)
        rate = f"{flight.message} at {flight.rate_hz:.1f} Hz"
        print_line(f"{flight.name}: {rate}, reference: {reference}, {use}")
        inputs.append({"name": flight.name, "sha256": flight.sha256, "use": use})
    reference = "; ".join(dict.fromkeys(map(_reference_text, flights)))
    return _plan(request, task, inputs, reference, {})


def _fitted(request: TuneRequest, plain: Profile, chosen: Split) -> Calibration:
    """What ``fuzzbee calibrate`` finds in what is searched on, and in nothing else."""
    from fuzzbee.calibration_report import report_calibration

    begin, end = time_window(request.begin, request.end)
    flight, _, last = chosen.tuning[0]
    if last < len(flight.truth):  # the rest of the only one is held out
        end = flight.begin_s + float(flight.time_s[last])
    searched = [part.flight.path for part in chosen.tuning]
    return report_calibration(searched, plain, window=TimeWindow(begin, end)).calibration


def _with_tuned_gain(base: Profile, groups: tuple[str, ...]) -> Profile:
    """The profile with the gain that the tuned numbers belong to: others would move nothing."""
    wanted = base.filter.gain
    if {"membership", "filter"} & {*groups}:
        wanted = "fuzzy"
    elif "gain" in groups and wanted != "fuzzy":
        wanted = "fixed"
    if wanted == base.filter.gain:
        return base
    print_line(f'the numbers of that gain are tuned: the result has filter.gain = "{wanted}"')
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
    begin, end = time_window(request.begin, request.end)
    options: dict[str, Any] = {
        "command": "tune",
        "algorithm": request.algorithm,
        "sources": sources,
        "cycles": cycles,
        "parameters": ",".join(task.groups),
        "base": _base_identity(request, task.before),
        "limit": limit if request.algorithm == "abc" else None,
        "objective": task.goal if isinstance(task, LogTask) else None,
        "reference": request.reference,
        "from": begin,
        "to": end,
    }
    identity = {
        "options": {name: value for name, value in options.items() if value is not None},
        "inputs": inputs,
        "seeds": {"search": request.seed, **seeds},
        "version": __version__,
    }
    return Plan(task, search, identity, reference)


def _read_flights(
    request: TuneRequest, base: Profile, refused: list[str], *, may_smooth: bool
) -> tuple[Flight, ...]:
    """All flights, first those not asked to be held out.

    A log that is held out may stand among the sources, too; but none may count twice. ``refused``
    takes a line for each log of which much was.
    """
    paths = [Path(source) for source in request.sources]
    for path in (*paths, *request.held_out):
        if not path.exists():
            raise InputError(f"{path}: no such file")
    apart = {path.resolve() for path in request.held_out}
    searched = [path for path in paths if path.resolve() not in apart]
    if not searched:
        raise InputError("--hold-out: nothing is left to tune on")
    window = time_window(request.begin, request.end)
    flights: dict[str, Flight] = {}
    for path in (*searched, *request.held_out):
        flight = read_flight(
            path, base, request.reference, window, refused.append, may_smooth=may_smooth
        )
        require_substance(flight)
        same = flights.setdefault(flight.sha256, flight)
        if same is not flight:
            raise InputError(f"{flight.name}: the same log as {same.name}")
    return tuple(flights.values())


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
            recoveries(part)


def _reference_text(log: Flight) -> str:
    """What the cost of a log is measured against."""
    if log.reference == "none":
        return "prediction of its own vectors, without a reference"
    name = REFERENCES[log.reference]
    return name if log.has_field else f"{name}, inclination only"


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


def _require_known(option: str, word: str | None, known: Collection[str | None]) -> None:
    if word not in known:
        choices = ", ".join(filter(None, known))
        raise InputError(f"{option} {word}: unknown; choose from {choices}")


def _require_numbers(request: TuneRequest) -> None:
    algorithm, (sources, cycles) = request.algorithm, request.budget
    _require_known("--algorithm", algorithm, ALGORITHMS)
    if algorithm == "cmaes":
        require_extra("cmaes", "--algorithm cmaes", "optimizers")
    fewest = ALGORITHMS[algorithm].fewest_sources
    if sources < fewest:
        raise InputError(f"--sources {sources}: {algorithm} needs at least {fewest}")
    if request.limit is not None and algorithm != "abc":
        raise InputError(f"--limit is the bees' own; {algorithm} has none")
    for option, number in (("--cycles", cycles), ("--limit", request.limit)):
        if number is not None and number < 1:
            raise InputError(f"{option} {number}: at least 1 is needed")
    if request.seed < 0:
        raise InputError(f"--seed {request.seed}: must be 0 or more")


def _groups(request: TuneRequest, default: tuple[str, ...]) -> tuple[str, ...]:
    if request.parameters is None:
        return default
    return tuple(name.strip() for name in request.parameters.split(",") if name.strip())


def _base_identity(request: TuneRequest, base: Profile) -> str:
    """The base's name; for a file the SHA-256 of its content, which its name does not fix."""
    name = request.base or (MIDPOINT if request.is_simulated else "imu")
    if name in (*SHIPPED, MIDPOINT):
        return name
    return f"sha256:{sha256(profile_to_toml(base).encode()).hexdigest()}"
