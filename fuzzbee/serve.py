"""The live service: everything opened, one loop, everything closed, the result told."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from estimator.errors import InputError
from fuzzbee import outputs, security
from fuzzbee.live_source import default_profile, open_recorder, open_source, require_fitting
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say

if TYPE_CHECKING:
    import zenoh

    from drivers.mavlink.recorder import Recorder
    from estimator.profile import Profile
    from fuzzbee.retuning import Retuning
    from fuzzbee.terminal import TerminalView
    from service.counts import Counts
    from service.parameters import ParameterRequests
    from service.pipeline import Pipeline
    from service.runner import Runner
    from service.sinks.sink import Sink
    from service.zenoh_session import OpeningSession, ZenohOptions


OK, FAILED = 0, 1
COMPILER_THREAD = "compiler"


def serve(options: RunOptions, *, verbose: bool) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, else 0.

    Raises:
        InputError: a source, profile, file or address that cannot be used.
    """
    opening = _begin_zenoh(options.zenoh)  # half a second's wait, in which all else is loaded
    try:
        return _serve(options, opening, verbose=verbose)
    finally:
        if opening is not None:
            opening.close()


def _serve(options: RunOptions, opening: "OpeningSession | None", *, verbose: bool) -> int:
    from drivers.endpoint import parse_endpoint
    from drivers.source import require_openable
    from estimator.profile import load_profile
    from service.parameters import ParameterRequests
    from service.signals import stop_on_signals
    from service.sinks.outbox import Outbox
    from service.steady import steady

    endpoint = parse_endpoint(options.source)
    require_openable(endpoint)
    profile = load_profile(options.profile or default_profile(endpoint))
    key = security.read_key(options.security)
    require_fitting(options, endpoint)
    outputs.viewer_options(options.outputs.view, options.outputs.rrd)  # refused before compiling
    may_meet_built_in = options.profile is None and endpoint.kind not in ("sim", "log")
    requests = ParameterRequests()
    conflicts: list[InputError] = []
    if opening is not None:
        _compile(profile, options.gain, with_raw=False, only_loads=True)
    with ExitStack() as stack:
        # whatever can be refused is opened before the compiler starts, and the source behind it
        session = _opened(opening, stack)
        recorder = None if options.record is None else open_recorder(options.record, stack)
        retuning = _open_retuning(options, requests, stack)
        pipeline = _pipeline(profile, options, retuning)
        with closed_if_unused() as sinks:
            sinks.extend(zenoh_sinks(session, options, profile, requests, conflicts))
            outputs.open_outputs(sinks, options.outputs, session, prefix_of(options), profile)
            _compile(profile, options.gain, with_raw=may_meet_built_in)
            sinks.append(open_view(options, verbose=verbose))  # which prints what the source says
            runner_of = open_source(endpoint, options, key, recorder, stack)
            sinks.extend(_recording_sinks(recorder, retuning))
            outbox = stack.enter_context(Outbox(sinks))
            sinks.clear()
        runner = runner_of(pipeline, outbox, requests)
        started_s = time.monotonic()
        failure: Exception | None = None
        with steady(), stop_on_signals(runner.stop):
            try:
                runner.run(options.seconds, lambda: bool(conflicts))
            except InputError:
                raise  # the log cannot be read any further
            except Exception as error:  # noqa: BLE001 - raised again when all is said
                failure = error
        seconds = time.monotonic() - started_s
    if outbox.stuck:
        say(f"not closed in time: {', '.join(outbox.stuck)}")
    report(summary(options, pipeline, runner, seconds, outbox.dropped), as_json=options.as_json)
    for problem in (failure, *conflicts):
        if problem is not None:
            raise problem
    heard_nobody = not _has_heard(pipeline) and not runner.was_stopped
    return FAILED if heard_nobody and options.seconds is not None else OK


def _has_heard(pipeline: "Pipeline") -> bool:
    """Whether there was a vehicle; what is refused has been heard, too."""
    return bool(pipeline.vehicles or pipeline.departures.vehicles or pipeline.refused_frames)


def _open_retuning(
    options: RunOptions, requests: "ParameterRequests", stack: ExitStack
) -> "Retuning | None":
    """The process that retunes, if it is asked for."""
    if not options.retune:
        return None
    from fuzzbee.retuning import Retuning

    return stack.enter_context(Retuning(requests, options.gain))


def _pipeline(profile: "Profile", options: RunOptions, retuning: "Retuning | None") -> "Pipeline":
    """The pipeline, whose estimators speak with the process that retunes."""
    from estimator.estimator import Estimator
    from service.pipeline import Pipeline

    pipeline = Pipeline(
        profile,
        system_id=options.system_id,
        new_estimator=lambda chosen: (
            Estimator(chosen, options.gain) if retuning is None else retuning.estimator(chosen)
        ),
        fits_built_in=options.profile is None,
    )
    if retuning is not None:
        retuning.watch(pipeline)
    return pipeline


def _recording_sinks(recorder: "Recorder | None", retuning: "Retuning | None") -> "list[Sink]":
    """What keeps the changes beside what arrives."""
    from service.sinks.recording import RecordingSink

    return [] if recorder is None or retuning is None else [RecordingSink(recorder)]


@contextmanager
def closed_if_unused() -> "Iterator[list[Sink]]":
    """A list of sinks, of which those that are still in it at an error are closed."""
    sinks: list[Sink] = []
    try:
        yield sinks
    finally:
        for sink in sinks:
            with suppress(Exception):
                sink.close()


def _compile(
    profile: "Profile", gain: float | None, *, with_raw: bool, only_loads: bool = False
) -> None:
    """Compile before anything is opened; ``with_raw`` also what the paper's raw vectors take.

    With ``only_loads`` nothing is done if something would have to be compiled.
    """
    from estimator.compilation.compiled import is_cached
    from estimator.live.resident import advance_raw
    from estimator.profile import load_profile
    from service.warm_up import compile_ahead, is_compiled, warm_up

    done: Future[None] = Future()

    def work() -> None:
        try:
            if only_loads and not is_compiled(profile):
                return
            warm_up(profile, gain)
            if with_raw and is_cached(advance_raw) is False:
                compile_ahead(load_profile("paper"), (advance_raw,))
        except BaseException as error:  # noqa: BLE001 - raised again below
            done.set_exception(error)
        finally:
            if not done.done():
                done.set_result(None)

    # in a thread: the compiler's callbacks swallow what a signal raises in them
    threading.Thread(target=work, name=COMPILER_THREAD, daemon=True).start()
    done.result()


def _begin_zenoh(options: "ZenohOptions | None") -> "OpeningSession | None":
    if options is None:
        return None
    from service.zenoh_session import OpeningSession

    return OpeningSession(options)


def _opened(opening: "OpeningSession | None", stack: ExitStack) -> "zenoh.Session | None":
    """The session, which is closed whatever happens."""
    if opening is None:
        return None
    from service.zenoh_session import close_session

    session = opening.session()
    stack.callback(close_session, session)
    return session


def open_zenoh(options: "ZenohOptions | None", stack: ExitStack) -> "zenoh.Session | None":
    """A session that is closed whatever happens."""
    if options is None:
        return None
    from service.zenoh_session import close_session, open_session

    session = open_session(options)
    stack.callback(close_session, session)
    return session


def zenoh_sinks(
    session: "zenoh.Session | None",
    options: RunOptions,
    profile: "Profile",
    requests: "ParameterRequests",
    conflicts: list[InputError],
    *,
    takes_encoded: bool = False,
) -> "list[Sink]":
    """The sink for the session, if there is one; ends the run if somebody else publishes there."""
    if session is None or options.zenoh is None:
        return []
    from service.sinks.zenoh import ZenohSink

    def end(key: str) -> None:
        text = f"another service publishes {key} already: stop it, give one of them another"
        conflicts.append(InputError(f"{text} --prefix, or publish beside it with --second"))

    def tell(key: str) -> None:
        say(f"another service publishes {key}, too")

    on_conflict = tell if options.second else end
    prefix = options.zenoh.prefix
    sink = ZenohSink(session, prefix, profile, requests, on_conflict, takes_encoded=takes_encoded)
    return [sink]


def prefix_of(options: RunOptions) -> str:
    """What the keys begin with."""
    from service.zenoh_session import DEFAULT_PREFIX

    return DEFAULT_PREFIX if options.zenoh is None else options.zenoh.prefix


def open_view(options: RunOptions, *, verbose: bool) -> "TerminalView":
    """The view on standard output; with --json messages only, on standard error."""
    from fuzzbee.terminal import PersonConsole, TerminalView

    errors = PersonConsole(stderr=True)
    where = "" if options.zenoh is None else f" → {options.zenoh.prefix}/*"
    profile = "" if options.profile is None else f", {options.profile}"
    title = f"fuzzbee run {options.source}, {options.rate_hz:g} Hz{profile}{where}"
    view = TerminalView(errors if options.as_json else PersonConsole(), errors, title)
    _show_log(view.say, verbose=verbose)
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


def summary(
    options: RunOptions, pipeline: "Pipeline", runner: "Runner", seconds: float, dropped: int
) -> dict[str, Any]:
    """The result of a run, as --json prints it."""
    from drivers.endpoint import parse_endpoint

    return {
        "source": options.source,
        "profile": options.profile or default_profile(parse_endpoint(options.source)),
        "rate_hz": options.rate_hz,
        "seconds": round(seconds, 3),
        "ticks": runner.ticks,
        "overruns": runner.overruns,
        "dropped": dropped,
        "lost": runner.lost,
        "malformed": pipeline.malformed,
        "refused": dict(sorted(pipeline.refused_frames.items())),
        "departed": {
            "vehicles": pipeline.departures.vehicles,
            "samples": pipeline.departures.samples,
            "attitudes": pipeline.departures.attitudes,
        },
        "vehicles": {
            vehicle.name: vehicle_summary(vehicle.counts) for vehicle in pipeline.vehicles
        },
    }


def vehicle_summary(counts: "Counts") -> dict[str, Any]:
    """One vehicle's part of the result."""
    return {
        "state": counts.state,
        "motion": counts.motion,
        "imu_message": counts.imu_message,
        "imu_rate_hz": round(counts.imu_rate_hz, 3),
        "worst_gap_s": counts.worst_gap_us / 1e6,
        "samples": counts.samples,
        "shed": counts.shed,
        "attitudes": counts.attitudes,
        "rejected": counts.rejected,
    }


def report(result: dict[str, Any], *, as_json: bool) -> None:
    """Tell the result of a run."""
    if as_json:
        import json

        print(json.dumps(result), flush=True)
        return
    vehicles = result["vehicles"]
    departed = result["departed"]
    number = len(vehicles) + departed["vehicles"]
    if not number:
        say(f"no vehicle was heard on {result['source']} in {result['seconds']:.1f} s")
        return
    attitudes = sum(vehicle["attitudes"] for vehicle in vehicles.values()) + departed["attitudes"]
    say(
        f"{attitudes} attitudes of {number} vehicle{'s' * (number != 1)}"
        f" in {result['seconds']:.1f} s, {result['overruns']} overruns"
    )
