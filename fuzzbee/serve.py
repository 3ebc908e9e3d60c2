"""The live service: everything opened, one loop, everything closed."""

import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.mavlink.recorder import Recorder
from drivers.player import Player
from drivers.resources import run_in_thread
from drivers.simulation.simulated_vehicle import PROFILES
from drivers.simulation.source import SimSource
from drivers.source import SIM_MOTION, open_live, require_openable
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile
from fuzzbee import options as opt
from fuzzbee import outputs, security
from fuzzbee.arguments import gain_of
from fuzzbee.notify import notify
from fuzzbee.run import RunOptions
from fuzzbee.run_report import conclude, recording_word, summary
from fuzzbee.terminal import PersonConsole, TerminalView
from fuzzbee.truth_score import ScoredPipeline
from service.parameters import ParameterRequests
from service.process import load_kernels
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.mavlink import RecordingSink
from service.sinks.sink import Outbox, Sink
from service.sinks.zenoh import ZenohSink
from service.zenoh_session import OpeningSession

if TYPE_CHECKING:
    from drivers.mavlink.link import MavlinkLink

DEFAULT_PROFILE = "imu"
LONG_WAIT_S = 1.0


def serve(options: RunOptions, opening: OpeningSession | None) -> int:
    """Open everything, loop until the end, close everything, and report; the exit status."""
    endpoint = parse_endpoint(options.source)
    require_openable(endpoint)
    if options.gain is not None:
        gain_of("--gain", options.gain)
    # of the built-in vehicle the one that fits its motion
    fitting = PROFILES[endpoint.path or SIM_MOTION] if endpoint.kind == "sim" else DEFAULT_PROFILE
    profile_name = options.profile or fitting
    profile = load_profile(profile_name)
    _require_fitting(options, endpoint)
    outputs.require_viewer(options.outputs.view, options.outputs.rrd)
    requests = ParameterRequests()
    problems: list[Exception] = []  # which end the run
    with ExitStack() as stack:
        # first, and once: what comes meanwhile is recorded
        source, recorder = _open_source(endpoint, options, stack)
        session = None if opening is None else opening.session()
        pipeline = _pipeline(profile, options, requests, stack)
        if options.truth or endpoint.kind == "sim":
            pipeline.scores = {}
        outbox = stack.enter_context(Outbox())
        for sink in _sinks(options, session, pipeline, requests, problems):
            outbox.add(sink)
        if recorder is not None and options.retune:
            outbox.add(RecordingSink(recorder))
        # in a thread: the compiler's callbacks swallow what a signal raises in them
        run_in_thread(load_kernels, "kernels").result()
        source.follow(pipeline.imu_in_use)
        runner = Runner(source, pipeline, outbox, rate_hz=options.rate_hz, requests=requests)
        runner.recording = partial(recording_word, [recorder, *outbox.sinks])
        seconds = _loop(runner, options.seconds, problems)
    result = summary(options, profile_name, seconds, runner, pipeline)
    if isinstance(source, SimSource) and source.waited_s >= LONG_WAIT_S and not options.as_json:
        notify(f"the vehicle waited {source.waited_s:.0f} s for this computer: it was too busy")
    return conclude(options, result, runner, pipeline.scores, problems)


def _loop(runner: Runner, end_s: float | None, problems: list[Exception]) -> float:
    """Loop until the end or the first problem; returns how long (s).

    A log has a clock and an end of its own, and a simulated vehicle counts its own seconds.
    """
    source = runner.source
    if isinstance(source, Player):
        runner.now_us, runner.is_finished = source.now_us, source.is_finished
    if isinstance(source, SimSource) and end_s is not None:
        flight, flight_s, end_s = source, end_s, None
        runner.is_finished = lambda: flight.flown_s >= flight_s
    started_s = time.monotonic()
    with stop_on_signals(runner.stop):
        try:
            runner.run(end_s, problems.__len__)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - raised again when all is reported
            problems.append(error)
    return time.monotonic() - started_s


def _require_fitting(options: RunOptions, endpoint: Endpoint) -> None:
    """Refuse options that the source has no use for."""
    if options.speed != 1.0 and endpoint.kind != "log":
        raise InputError(f"--speed is for logs, {endpoint} comes at its own pace")
    of_link = ("record", "request_rate_hz", "allow_system_ids")
    why = {"log": f"{endpoint} is a log", "sim": "sim: has none; start fuzzbee sim --to URL"}
    for option in opt.asked_for(options, *of_link, "signing_key_file", "insecure_key_file"):
        if endpoint.kind in why:
            raise InputError(f"{option} is for a MAVLink link, {why[endpoint.kind]}")


def _open_source(
    endpoint: Endpoint, options: RunOptions, stack: ExitStack
) -> tuple["MavlinkLink | Player", Recorder | None]:
    """Open a link, ``sim:`` or a log that is played; and a link's recorder, if asked for."""
    if endpoint.kind == "log":
        from drivers.logs.open import imu_events, open_log  # which loads every format

        log = stack.enter_context(open_log(Path(endpoint.path)))
        return Player(imu_events(log), options.speed, follow=log.follow), None
    policy = security.open_policy(options, stack)
    if options.outputs.send_as is not None:
        policy = policy._replace(own=outputs.parse_address_of(options.outputs.send_as))
    shows_others = options.truth or options.outputs.view or options.outputs.rrd
    target = Path(options.record or "")
    is_new = not target.exists()
    recorder = None
    if options.record is not None:  # into a folder, if there is one or the name has no suffix
        in_folder = (
            options.record.endswith("/") or target.is_dir() or (is_new and not target.suffix)
        )
        recorder = stack.enter_context(Recorder(target, in_folder=in_folder))
    try:
        source = open_live(
            endpoint,
            recorder=recorder,
            request_rate_hz=options.request_rate_hz,
            policy=policy,
            references=bool(shows_others),  # else they need not be decoded
        )
        stack.enter_context(source)
    except BaseException:
        if recorder is not None and is_new:
            recorder.close()
            with suppress(OSError):
                if target.is_dir():
                    target.rmdir()
                elif target.stat().st_size == 0:
                    target.unlink()
        raise
    return source, recorder


def _pipeline(
    profile: Profile, options: RunOptions, requests: ParameterRequests, stack: ExitStack
) -> ScoredPipeline:
    """The pipeline, whose estimators are watched by a thread that retunes if that is asked for."""
    pipeline = ScoredPipeline(
        profile,
        system_id=options.system_id,
        new_estimator=partial(Estimator, fixed_gain=options.gain),
        fits_built_in=options.profile is None,
        rate_hz=options.rate_hz,
    )
    if options.retune:
        from fuzzbee.retuning import Retuning  # which loads what searches

        retuning = stack.enter_context(Retuning(requests, options.gain))
        retuning.pipeline, pipeline.new_estimator = pipeline, retuning.estimator
    return pipeline


def _sinks(
    options: RunOptions,
    session: zenoh.Session | None,
    pipeline: ScoredPipeline,
    requests: ParameterRequests,
    problems: list[Exception],
) -> Iterator[Sink]:
    """Open what was asked for, and a view last, which prints what the source reports."""

    def on_conflict(key: str) -> None:
        if options.second:
            notify(f"another service publishes {key}, too")
            return
        text = f"another service publishes {key} already: stop it, give one of them another"
        problems.append(InputError(f"{text} --prefix, or publish beside it with --second"))

    if session is not None:
        yield ZenohSink(session, options.zenoh.prefix, pipeline.profile, requests, on_conflict)
    yield from outputs.open_outputs(options, session)
    view = _open_view(options)
    view.scores = pipeline.scores
    yield view


def _open_view(options: RunOptions) -> TerminalView:
    """The view on standard output; with --json messages only, on standard error."""
    errors = PersonConsole(stderr=True)
    where = "" if options.no_zenoh else f" → {options.zenoh.prefix}/*"
    profile = "" if options.profile is None else f", {options.profile}"
    title = f"fuzzbee run {options.source}, {options.rate_hz:g} Hz{profile}{where}"
    view = TerminalView(errors if options.as_json else PersonConsole(), errors, title)
    # log lines go through the view, so that they do not break up its table
    verbose, handler, logger = options.verbose, logging.Handler(), logging.getLogger("drivers")
    handler.emit = lambda record: view.notify(handler.format(record))  # type: ignore[method-assign]
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # what happens to the link comes as events, once each; the log repeats it in detail
    logging.getLogger("drivers.mavlink.link").setLevel(logging.NOTSET if verbose else logging.ERROR)
    return view
