"""From the options of ``fuzzbee tune`` to a plan of the search; all checks come before any work."""

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from estimator.errors import InputError
from estimator.profile import SHIPPED, Profile, load_profile, merge_profile
from fuzzbee.version import __version__
from tuning.log_dataset import BETTER_LOG, LogData, read_log
from tuning.log_task import MEMBERSHIP_RATE_HZ, LogTask, default_groups
from tuning.objective import Task
from tuning.paper_task import FIRST_RESERVED_SEED, PaperTask, midpoint_profile
from tuning.search import ALGORITHMS, SearchOptions

SIMULATION = "sim:"
MIDPOINT = "midpoint"
DEFAULT_NOISE_SEEDS = "100-107"
DEFAULT_HELD_OUT_SEEDS = "200-219"
# SciPy's differential evolution mixes three other members with two more.
FEWEST_SOURCES = {"abc": 2, "cmaes": 1, "de": 5}


class TuneRequest(NamedTuple):
    """The options that determine the result, as given."""

    sources: tuple[str, ...]
    output: Path
    base: str | None
    algorithm: str
    food_sources: int
    cycles: int
    limit: int | None
    seed: int
    parameters: str | None
    noise_seeds: str | None
    held_out_seeds: str | None


class Plan(NamedTuple):
    """What is searched, and what goes into the file's provenance.

    ``identity`` is everything that determines the result, as plain JSON values.
    ``reference`` says what the cost is measured against.
    """

    task: Task
    options: SearchOptions
    output: Path
    identity: dict[str, Any]
    inputs: list[dict[str, str]]
    reference: str


def plan(request: TuneRequest, tell: Callable[[str], None]) -> Plan:
    """Check everything and prepare the search; ``tell`` takes lines for a person.

    Raises:
        InputError: options that are infeasible, empty or contradict each other,
            and sources that cannot be used.
    """
    _require_numbers(request)
    _require_output(request)
    if SIMULATION in request.sources:
        return _simulation_plan(request)
    return _log_plan(request, tell)


def _simulation_plan(request: TuneRequest) -> Plan:
    if len(request.sources) > 1:
        raise InputError("tune: sim: stands alone, not beside logs")
    noise = seeds("--noise-seeds", request.noise_seeds or DEFAULT_NOISE_SEEDS)
    held_out = seeds("--held-out-seeds", request.held_out_seeds or DEFAULT_HELD_OUT_SEEDS)
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
    options = _search_options(request, task)
    inputs = [{"name": SIMULATION}]
    seeds_used: dict[str, Any] = {
        "search": request.seed,
        "noise": _seeds_text(noise),
        "held_out": _seeds_text(held_out),
    }
    identity = _identity(
        request, options, groups=groups, inputs=inputs, seeds_used=seeds_used, base=base
    )
    return Plan(
        task=task,
        options=options,
        output=request.output,
        identity=identity,
        inputs=inputs,
        reference="simulated vehicle's truth",
    )


def _log_plan(request: TuneRequest, tell: Callable[[str], None]) -> Plan:
    for option, value in (
        ("--noise-seeds", request.noise_seeds),
        ("--held-out-seeds", request.held_out_seeds),
    ):
        if value is not None:
            raise InputError(f"{option} goes with sim: only; a log has its own noise")
    paths = _log_paths(request)
    base = load_profile(request.base or "imu")
    logs = tuple(read_log(path, base.mounting) for path in paths)
    _require_distinct(logs)
    slowest = min(logs, key=lambda log: log.rate_hz)
    groups = _groups(request, default_groups(slowest.rate_hz))
    if slowest.rate_hz < MEMBERSHIP_RATE_HZ:
        if {"membership", "filter"} & {*groups}:
            raise InputError(
                f"--parameters {request.parameters}: {slowest.name} has IMU data at "
                f"{slowest.rate_hz:.1f} Hz; the fuzzy controller is tuned from "
                f"{MEMBERSHIP_RATE_HZ:g} Hz on ({BETTER_LOG})"
            )
        tell(
            f"{slowest.name}: {slowest.message} at {slowest.rate_hz:.1f} Hz allows to tune "
            f"confidences, bias and conditioning, not the memberships ({BETTER_LOG})"
        )
    if "membership" in groups and base.filter.gain != "fuzzy":
        tell('the fuzzy gain\'s rules are tuned: the result has filter.gain = "fuzzy"')
        base = merge_profile(base, {"filter": {"gain": "fuzzy"}})
    task = LogTask(base, groups, logs)
    counts = task.segment_counts()
    for log in logs:
        tell(
            f"{log.name}: {log.message} at {log.rate_hz:.1f} Hz, reference: {_reference_text(log)}"
        )
    tell(f"{counts[0]} segments to tune on, {counts[1]} held out")
    options = _search_options(request, task)
    inputs = [{"name": log.name, "sha256": log.sha256} for log in logs]
    seeds_used = {"search": request.seed}
    identity = _identity(
        request, options, groups=groups, inputs=inputs, seeds_used=seeds_used, base=base
    )
    reference = "; ".join(dict.fromkeys(_reference_text(log) for log in logs))
    return Plan(
        task=task,
        options=options,
        output=request.output,
        identity=identity,
        inputs=inputs,
        reference=reference,
    )


def _reference_text(log: LogData) -> str:
    """What the cost of a log is measured against."""
    name = {
        "sim": "simulator's truth",
        "autopilot": "autopilot's attitude",
        "none": "prediction of its own vectors, without a reference",
    }[log.reference]
    return name if log.has_field or log.reference == "none" else f"{name}, inclination only"


def _log_paths(request: TuneRequest) -> list[Path]:
    paths = [Path(source) for source in request.sources]
    for source, path in zip(request.sources, paths, strict=True):
        if not path.exists():
            raise InputError(f"{source}: no such file")
    return paths


def _require_distinct(logs: tuple[LogData, ...]) -> None:
    """Refuse a log that is given twice: it would count twice."""
    seen: dict[str, str] = {}
    for log in logs:
        if log.sha256 in seen:
            raise InputError(f"{log.name}: the same log as {seen[log.sha256]}")
        seen[log.sha256] = log.name


def seeds(option: str, text: str) -> range:
    """``A-B``, both included, or a single ``A``, below the reserved seeds.

    Raises:
        InputError: not of that form, empty, or reserved.
    """
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise InputError(f"{option} {text}: must be A-B with whole numbers, such as 100-107")
    chosen = range(int(first), int(last or first) + 1)
    if not chosen:
        raise InputError(f"{option} {text}: the range is empty")
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
    if request.algorithm == "cmaes" and find_spec("cmaes") is None:
        raise InputError("--algorithm cmaes: needs the package cmaes (the extra 'optimizers')")
    fewest = FEWEST_SOURCES[request.algorithm]
    if request.food_sources < fewest:
        raise InputError(
            f"--sources {request.food_sources}: {request.algorithm} needs at least {fewest}"
        )
    if request.cycles < 1:
        raise InputError(f"--cycles {request.cycles}: at least 1 is needed")
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
    for source in request.sources:
        log = source != SIMULATION and Path(source).exists()
        if log and output.exists() and output.samefile(source):
            raise InputError(f"-o {output}: is also a source")


def _groups(request: TuneRequest, default: tuple[str, ...]) -> tuple[str, ...]:
    if request.parameters is None:
        return default
    return tuple(name.strip() for name in request.parameters.split(",") if name.strip())


def _search_options(request: TuneRequest, task: Task) -> SearchOptions:
    limit = request.limit
    if limit is None:
        limit = request.food_sources * task.space.dimensions
    return SearchOptions(
        algorithm=request.algorithm,
        food_sources=request.food_sources,
        cycles=request.cycles,
        limit=limit,
        seed=request.seed,
    )


def _identity(
    request: TuneRequest,
    options: SearchOptions,
    *,
    groups: tuple[str, ...],
    inputs: list[dict[str, str]],
    seeds_used: dict[str, Any],
    base: Profile,
) -> dict[str, Any]:
    """Canonical options: what was left to a default counts as if it had been given."""
    canonical: dict[str, Any] = {
        "command": "tune",
        "algorithm": options.algorithm,
        "sources": options.food_sources,
        "cycles": options.cycles,
        "parameters": ",".join(groups),
        "base": _base_identity(request, base),
    }
    if options.algorithm == "abc":
        canonical["limit"] = options.limit
    return {"options": canonical, "inputs": inputs, "seeds": seeds_used, "version": __version__}


def _base_identity(request: TuneRequest, base: Profile) -> str:
    """The base's name; for a file the SHA-256 of what it says, which its name does not fix."""
    from hashlib import sha256

    from estimator.profile import profile_to_toml

    name = request.base or (MIDPOINT if SIMULATION in request.sources else "imu")
    if name in (*SHIPPED, MIDPOINT):
        return name
    return f"sha256:{sha256(profile_to_toml(base).encode()).hexdigest()}"
