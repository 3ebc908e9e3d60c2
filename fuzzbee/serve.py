"""The live service: everything opened, one loop, everything closed."""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

import zenoh

from drivers.aside import aside
from drivers.endpoint import parse_endpoint
from drivers.simulation.source import SimSource
from drivers.source import require_openable
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile
from fuzzbee import outputs, security
from fuzzbee.live_source import default_profile, make_runner, open_recorded, require_fitting
from fuzzbee.notify import notify
from fuzzbee.run import RunOptions
from fuzzbee.run_report import conclude, recording_word, summary
from fuzzbee.terminal import PersonConsole, TerminalView
from fuzzbee.truth_score import ScoredPipeline
from fuzzbee.zenoh_options import opened
from service.parameters import ParameterRequests
from service.process import load_kernels
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.mavlink import RecordingSink
from service.sinks.sink import Outbox, Sink
from service.sinks.zenoh import ZenohSink
from service.zenoh_session import OpeningSession

if TYPE_CHECKING:
    from fuzzbee.retuning import Retuning

LONG_WAIT_S = 1.0


def serve(options: RunOptions, opening: OpeningSession | None) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, else 0.
    """
    endpoint = parse_endpoint(options.source)
    require_openable(endpoint)
    profile_name = options.profile or default_profile(endpoint)
    profile = load_profile(profile_name)
    asked = options.security
    key = security.key_of(asked.signing_key_file, is_insecure=asked.insecure_key_file)
    require_fitting(options, endpoint)
    outputs.viewer_options(options.outputs.view, options.outputs.rrd)
    requests = ParameterRequests()
    conflicts: list[InputError] = []  # which end the run
    with ExitStack() as stack:
        # first, and once: what comes meanwhile is recorded
        source, recorder = open_recorded(endpoint, options, key, stack)
        session = None if opening is None else opened(opening, stack)
        retuning = _open_retuning(options, requests, stack)
        pipeline = _pipeline(profile, options, retuning)
        if options.truth or endpoint.kind == "sim":
            pipeline.scores = {}
        sinks = _open_sinks(options, session, pipeline, requests, conflicts)
        if recorder is not None and retuning is not None:
            sinks.append(RecordingSink(recorder))
        outbox = stack.enter_context(Outbox(sinks))
        recording = partial(recording_word, [recorder, *sinks])
        # in a thread: the compiler's callbacks swallow what a signal raises in them
        aside(load_kernels, "kernels").result()
        runner = make_runner(source, pipeline, outbox, requests, options, recording)
        end_s = None if isinstance(source, SimSource) else options.seconds
        seconds, failure = _loop(runner, end_s, conflicts)
    result = summary(options, profile_name, seconds, runner, pipeline, recording())
    if pipeline.scores is not None:
        result["truth"] = {name: score.result() for name, score in pipeline.scores.items()}
    if not options.as_json:
        if isinstance(source, SimSource) and source.waited_s >= LONG_WAIT_S:
            notify(f"the vehicle waited {source.waited_s:.0f} s for this computer: it was too busy")
        for name, score in (pipeline.scores or {}).items():
            if score.verdict():
                notify(f"vehicle {name} {score.verdict()}")
    problems = [failure, *conflicts]
    return conclude(options, result, outbox, problems, was_stopped=runner.was_stopped)


def _loop(
    runner: Runner, seconds: float | None, conflicts: list[InputError]
) -> tuple[float, Exception | None]:
    """Loop until the end; returns how long (s), and what went wrong."""
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


def _open_retuning(
    options: RunOptions, requests: ParameterRequests, stack: ExitStack
) -> "Retuning | None":
    """The process that retunes, if it is asked for."""
    if not options.retune:
        return None
    from fuzzbee.retuning import Retuning  # which loads what searches

    return stack.enter_context(Retuning(requests, options.gain))


def _pipeline(profile: Profile, options: RunOptions, retuning: "Retuning | None") -> ScoredPipeline:
    """The pipeline, whose estimators speak with the process that retunes."""
    pipeline = ScoredPipeline(
        profile,
        system_id=options.system_id,
        new_estimator=lambda chosen: (
            Estimator(chosen, options.gain) if retuning is None else retuning.estimator(chosen)
        ),
        fits_built_in=options.profile is None,
        rate_hz=options.rate_hz,
    )
    if retuning is not None:
        retuning.watch(pipeline)
    return pipeline


def _open_sinks(
    options: RunOptions,
    session: zenoh.Session | None,
    pipeline: ScoredPipeline,
    requests: ParameterRequests,
    conflicts: list[InputError],
) -> list[Sink]:
    """Open what was asked for, and a view last, which prints what the source says.

    If another service publishes there, ``conflicts`` get an error.
    """

    def on_conflict(key: str) -> None:
        if options.second:
            notify(f"another service publishes {key}, too")
            return
        text = f"another service publishes {key} already: stop it, give one of them another"
        conflicts.append(InputError(f"{text} --prefix, or publish beside it with --second"))

    sinks: list[Sink] = []
    prefix = options.zenoh.prefix
    with ExitStack() as opened_so_far:
        if session is not None:
            sinks.append(ZenohSink(session, prefix, pipeline.profile, requests, on_conflict))
            opened_so_far.callback(sinks[0].close)
        for sink in outputs.open_outputs(options.outputs, session, prefix, options.rate_hz):
            sinks.append(sink)
            opened_so_far.callback(sink.close)
        view = open_view(options)
        view.scores = pipeline.scores
        opened_so_far.pop_all()
    return [*sinks, view]


def open_view(options: RunOptions) -> TerminalView:
    """The view on standard output; with --json messages only, on standard error."""
    errors = PersonConsole(stderr=True)
    where = "" if options.no_zenoh else f" → {options.zenoh.prefix}/*"
    profile = "" if options.profile is None else f", {options.profile}"
    title = f"fuzzbee run {options.source}, {options.rate_hz:g} Hz{profile}{where}"
    view = TerminalView(errors if options.as_json else PersonConsole(), errors, title)
    _show_log(view.notify, verbose=options.verbose)
    return view


class _ViewHandler(logging.Handler):
    """Prints log lines through the view, so that they do not break up its table."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        super().__init__()
        self._say = notify

    def emit(self, record: logging.LogRecord) -> None:
        self._say(self.format(record))


def _show_log(notify: Callable[[str], None], *, verbose: bool) -> None:
    logger = logging.getLogger("drivers")
    logger.handlers = [_ViewHandler(notify)]
    logger.propagate = False
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # what happens to the link comes as events, once each; the log repeats it in detail
    logging.getLogger("drivers.mavlink.link").setLevel(logging.NOTSET if verbose else logging.ERROR)
