"""The live service: everything opened, one loop, everything closed."""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

import zenoh

from drivers.aside import aside
from drivers.endpoint import parse_endpoint
from drivers.simulation.source import SimSource
from drivers.source import require_openable
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile
from fuzzbee import outputs, security
from fuzzbee.live_source import default_profile, make_runner, open_source, require_fitting
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
    problems: list[Exception] = []  # which end the run
    with ExitStack() as stack:
        # first, and once: what comes meanwhile is recorded
        source, recorder = open_source(endpoint, options, key, stack)
        session = None if opening is None else opened(opening, stack)
        pipeline = _pipeline(profile, options, requests, stack)
        if options.truth or endpoint.kind == "sim":
            pipeline.scores = {}
        sinks = _open_sinks(options, session, pipeline, requests, problems)
        if recorder is not None and options.retune:
            sinks.append(RecordingSink(recorder))
        outbox = stack.enter_context(Outbox(sinks))
        recording = partial(recording_word, [recorder, *sinks])
        # in a thread: the compiler's callbacks swallow what a signal raises in them
        aside(load_kernels, "kernels").result()
        runner = make_runner(source, pipeline, outbox, options, requests, recording)
        end_s = None if isinstance(source, SimSource) else options.seconds
        seconds = _loop(runner, end_s, problems)
    result = summary(options, profile_name, seconds, runner, pipeline, recording())
    if isinstance(source, SimSource) and source.waited_s >= LONG_WAIT_S and not options.as_json:
        notify(f"the vehicle waited {source.waited_s:.0f} s for this computer: it was too busy")
    return conclude(options, result, outbox, pipeline, problems, was_stopped=runner.was_stopped)


def _loop(runner: Runner, end_s: float | None, problems: list[Exception]) -> float:
    """Loop until the end or the first problem; returns how long (s)."""
    started_s = time.monotonic()
    with stop_on_signals(runner.stop):
        try:
            runner.run(end_s, problems.__len__)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - raised again when all is said
            problems.append(error)
    return time.monotonic() - started_s


def _pipeline(
    profile: Profile, options: RunOptions, requests: ParameterRequests, stack: ExitStack
) -> ScoredPipeline:
    """The pipeline, whose estimators are watched by a thread that retunes if that is asked for."""
    retuning = None
    if options.retune:
        from fuzzbee.retuning import Retuning  # which loads what searches

        retuning = stack.enter_context(Retuning(requests, options.gain))
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
    problems: list[Exception],
) -> list[Sink]:
    """Open what was asked for, and a view last, which prints what the source reports.

    That another service publishes there is one of ``problems``.
    """

    def on_conflict(key: str) -> None:
        if options.second:
            notify(f"another service publishes {key}, too")
            return
        text = f"another service publishes {key} already: stop it, give one of them another"
        problems.append(InputError(f"{text} --prefix, or publish beside it with --second"))

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
        self._notify = notify

    def emit(self, record: logging.LogRecord) -> None:
        self._notify(self.format(record))


def _show_log(notify: Callable[[str], None], *, verbose: bool) -> None:
    logger = logging.getLogger("drivers")
    logger.handlers = [_ViewHandler(notify)]
    logger.propagate = False
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # what happens to the link comes as events, once each; the log repeats it in detail
    logging.getLogger("drivers.mavlink.link").setLevel(logging.NOTSET if verbose else logging.ERROR)
