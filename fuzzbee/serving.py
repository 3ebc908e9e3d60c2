"""The steps of the live service: prepare, show, loop, report."""

import json
import logging
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

import zenoh

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.simulation.simulated_vehicle import PROFILES
from drivers.source import require_openable
from estimator.errors import InputError
from estimator.profile import Profile, load_profile
from fuzzbee import outputs, security
from fuzzbee.live_source import default_profile, require_fitting
from fuzzbee.recordings import FAILED as NOT_WHOLE
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say
from fuzzbee.terminal import PersonConsole, TerminalView
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.sink import Outbox, Sink
from service.sinks.zenoh import ZenohSink
from service.vehicle_status import counts

if TYPE_CHECKING:
    from fuzzbee.truth_score import TruthScore

OK, FAILED = 0, 1


class Prepared(NamedTuple):
    """What the options name, checked as far as it can be without opening anything."""

    endpoint: Endpoint
    profile_name: str
    profile: Profile
    key: bytes | None  # that frames must be signed with


def prepare(options: RunOptions) -> Prepared:
    """Check the source, profile, key and outputs.

    Raises:
        InputError: one of them cannot be used, or options contradict each other.
    """
    endpoint = parse_endpoint(options.source)
    require_openable(endpoint)
    name = options.profile or default_profile(endpoint)
    profile = load_profile(name)
    key = security.read_key(options.security)
    require_fitting(options, endpoint)
    outputs.viewer_options(options.outputs.view, options.outputs.rrd)
    return Prepared(endpoint, name, profile, key)


def open_sinks(
    options: RunOptions,
    session: zenoh.Session | None,
    profile: Profile,
    requests: ParameterRequests,
    conflicts: list[InputError],
    scores: "dict[str, TruthScore] | None",
) -> list[Sink]:
    """Open what was asked for, and a view last, which prints what the source says.

    If another service publishes there, ``conflicts`` get an error that ends the run.

    Raises:
        InputError: one of them cannot be opened; those before it are closed.
    """

    def on_conflict(key: str) -> None:
        if options.second:
            say(f"another service publishes {key}, too")
            return
        text = f"another service publishes {key} already: stop it, give one of them another"
        conflicts.append(InputError(f"{text} --prefix, or publish beside it with --second"))

    sinks: list[Sink] = []
    prefix = options.zenoh.prefix
    with ExitStack() as opened:
        if session is not None:
            sinks.append(ZenohSink(session, prefix, profile, requests, on_conflict))
            opened.callback(sinks[0].close)
        for sink in outputs.open_outputs(options.outputs, session, prefix, options.rate_hz):
            sinks.append(sink)
            opened.callback(sink.close)
        view = open_view(options)
        view.scores = scores
        sinks.append(view)
        opened.pop_all()
    return sinks


def open_view(options: RunOptions) -> TerminalView:
    """The view on standard output; with --json messages only, on standard error."""
    errors = PersonConsole(stderr=True)
    where = "" if options.no_zenoh else f" → {options.zenoh.prefix}/*"
    profile = "" if options.profile is None else f", {options.profile}"
    title = f"fuzzbee run {options.source}, {options.rate_hz:g} Hz{profile}{where}"
    view = TerminalView(errors if options.as_json else PersonConsole(), errors, title)
    _show_log(view.say, verbose=options.verbose)
    return view


class _ViewHandler(logging.Handler):
    """Prints log lines through the view, so that they do not break up its table."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__()
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(self.format(record))


def _show_log(say: Callable[[str], None], *, verbose: bool) -> None:
    logger = logging.getLogger("drivers")
    logger.handlers = [_ViewHandler(say)]
    logger.propagate = False
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # what happens to the link comes as events, once each; the log repeats it in detail
    logging.getLogger("drivers.mavlink.link").setLevel(logging.NOTSET if verbose else logging.ERROR)


def run_loop(
    runner: Runner, seconds: float | None, conflicts: list[InputError]
) -> tuple[float, Exception | None]:
    """Loop until the end; returns how long (s), and what went wrong.

    Raises:
        InputError: a log that cannot be read any further.
    """
    started_s = time.monotonic()
    failure: Exception | None = None
    with stop_on_signals(runner.stop):
        try:
            runner.run(seconds, conflicts.__len__)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - raised again when all is said
            failure = error
    return time.monotonic() - started_s, failure


def summary(
    options: RunOptions,
    profile_name: str,
    seconds: float,
    runner: Runner,
    pipeline: Pipeline,
    recording: str,
) -> dict[str, Any]:
    """The result of a run, as --json prints it."""
    return {
        "source": options.source,
        "profile": _in_force(options, profile_name, pipeline),
        "rate_hz": options.rate_hz,
        "seconds": round(seconds, 3),
        "ticks": runner.ticks,
        "overruns": runner.overruns,
        "dropped": runner.dropped,
        "lost": runner.lost,
        "malformed": pipeline.malformed,
        "refused": dict(sorted(pipeline.refused_frames.items())),
        **({"recording": recording} if recording else {}),
        "heard": sorted(pipeline.heard),
        "departed": pipeline.evictions.counts._asdict(),
        "vehicles": {vehicle.name: counts(vehicle) for vehicle in pipeline.vehicles},
    }


def _in_force(options: RunOptions, name: str, pipeline: Pipeline) -> str:
    """The profile's name; fuzzbee's own vehicles have had the one that fits their motion."""
    if options.profile is not None:
        return name
    fitting = {PROFILES.get(vehicle.built_in_motion or "") for vehicle in pipeline.vehicles}
    return fitting.pop() or name if len(fitting) == 1 else name


def conclude(
    options: RunOptions,
    result: dict[str, Any],
    outbox: Outbox,
    problems: Iterable[Exception | None],
    *,
    was_stopped: bool,
) -> int:
    """Tell the result and raise what went wrong.

    The status is 1 if nobody was heard in the time given, or a recording is not whole, else 0.

    Who was refused has been heard, too.
    """
    if outbox.stuck:
        say(f"not closed in time: {', '.join(outbox.stuck)}")
        if "recording" in result:  # nobody knows what it lacks
            result["recording"] = NOT_WHOLE
    for error in outbox.untold:
        say(error)
    _report(result, as_json=options.as_json)
    for problem in problems:
        if problem is not None:
            raise problem
    heard = result["vehicles"] or result["departed"]["vehicles"] or result["refused"]
    is_whole = result.get("recording") != NOT_WHOLE
    return OK if is_whole and (heard or was_stopped or options.seconds is None) else FAILED


def _report(result: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(result), flush=True)
        return
    vehicles = result["vehicles"]
    departed = result["departed"]
    number = len(vehicles) + departed["vehicles"]
    if not number:
        others = ", ".join(map(str, result["heard"]))
        which = f" but system id {others}" if others else ""
        say(f"no vehicle{which} was heard on {result['source']} in {result['seconds']:.1f} s")
        return
    attitudes = sum(vehicle["attitudes"] for vehicle in vehicles.values()) + departed["attitudes"]
    say(
        f"{attitudes} attitudes of {number} vehicle{'s' * (number != 1)}"
        f" in {result['seconds']:.1f} s, {result['overruns']} overruns"
    )
