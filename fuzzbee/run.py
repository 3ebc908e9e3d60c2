"""``fuzzbee run``: the live service."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import outputs, security, zenoh_options
from fuzzbee.options import Json, Seconds, Verbose, require_gain, require_positive
from fuzzbee.say import say

if TYPE_CHECKING:
    import zenoh

    from drivers.endpoint import Endpoint
    from drivers.mavlink.recorder import Recorder
    from estimator.profile import Profile
    from fuzzbee.retuning import Retuning
    from fuzzbee.terminal import TerminalView
    from service.parameters import ParameterRequests
    from service.pipeline import Pipeline
    from service.runner import LiveSource, Runner
    from service.sinks.sink import Sink
    from service.zenoh_session import ZenohOptions

OK, FAILED = 0, 1
MAX_RATE_HZ = 1000.0
DEFAULT_PROFILE = "imu"
COMPILER_THREAD = "compiler"

EPILOG = """Examples:

  fuzzbee run sim:flight

  fuzzbee run udpin:127.0.0.1:14550 --rate 50

  fuzzbee run /dev/ttyUSB0:57600 --request-rate 50 --record flight.tlog

  fuzzbee run flight.tlog --speed 4

  fuzzbee run tcp:127.0.0.1:5760 -m client -e tcp/192.168.1.10:7447"""


class RunOptions(NamedTuple):
    """What was asked for, checked as far as it can be without opening anything."""

    source: str
    rate_hz: float
    seconds: float | None
    profile: str | None  # None: the one that fits
    gain: float | None
    as_json: bool
    record: str | None
    request_rate_hz: float | None
    speed: float
    system_id: int | None
    retune: bool
    zenoh: "ZenohOptions | None"
    outputs: outputs.OutputOptions
    security: security.SecurityOptions
    second: bool = False


def run(
    source: Annotated[
        str,
        typer.Argument(
            help="sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log"
            " file."
        ),
    ] = "sim:",
    rate: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Attitudes a second.")
    ] = 100.0,
    seconds: Seconds = None,
    profile: Annotated[
        str | None,
        typer.Option(
            "--profile",
            metavar="NAME|FILE",
            help="paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own"
            " vehicle with the paper's signals: paper.",
            autocompletion=lambda: ["paper", "imu", "adaptive"],
        ),
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option("--gain", metavar="K", help="A fixed gain instead of the fuzzy one."),
    ] = None,
    as_json: Json = False,
    record: Annotated[
        str | None,
        typer.Option(
            "--record",
            metavar="FILE|DIR",
            help="Record what arrives: FILE.tlog, or a folder for a file an hour.",
        ),
    ] = None,
    request_rate: Annotated[
        float | None,
        typer.Option("--request-rate", metavar="HZ", help="Ask the vehicle for this IMU rate."),
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", help="Play a log X times as fast.")
    ] = 1.0,
    system_id: Annotated[
        int | None, typer.Option("--system-id", metavar="ID", help="Only this vehicle.")
    ] = None,
    retune: Annotated[
        bool,
        typer.Option("--retune", help="Retune a few numbers whenever the sensors' noise changes."),
    ] = False,
    allow_system_ids: security.AllowSystemIds = None,
    signing_key_file: security.SigningKeyFile = None,
    no_zenoh: Annotated[bool, typer.Option("--no-zenoh", help="Publish nothing.")] = False,
    ros: outputs.Ros = False,
    ros_domain: outputs.RosDomain = 0,
    send_attitude: outputs.SendAttitude = None,
    metrics: outputs.Metrics = None,
    view: outputs.View = None,
    rrd: outputs.Rrd = None,
    listen: zenoh_options.Listen = None,
    connect: zenoh_options.Connect = None,
    mode: zenoh_options.Mode = "peer",
    config_file: zenoh_options.ConfigFile = None,
    settings: zenoh_options.Settings = None,
    multicast: zenoh_options.Multicast = False,
    prefix: zenoh_options.Prefix = "fuzzbee",
    second: Annotated[
        bool,
        typer.Option(
            "--second",
            help="Publish even if another service publishes the same vehicle.",
            rich_help_panel=zenoh_options.PANEL,
        ),
    ] = False,
    verbose: Verbose = False,
) -> int:
    """Estimate attitudes live and publish them on Zenoh."""
    require_positive("--rate", rate)
    if rate > MAX_RATE_HZ:
        raise InputError(f"--rate {rate:g}: should be at most {MAX_RATE_HZ:g}")
    for option, value in (
        ("--seconds", seconds),
        ("--request-rate", request_rate),
        ("--speed", speed),
    ):
        require_positive(option, value)
    require_gain(gain)
    if system_id is not None and not 1 <= system_id <= 255:
        raise InputError(f"--system-id {system_id}: should be 1 to 255")
    outputs.require_own_file(rrd, [source])
    zenoh = zenoh_options.zenoh_options(
        listen=listen,
        connect=connect,
        mode=mode,
        config_file=config_file,
        settings=settings,
        multicast=multicast,
        prefix=prefix,
    )
    options = RunOptions(
        source=source,
        rate_hz=rate,
        seconds=seconds,
        profile=profile,
        gain=gain,
        as_json=as_json,
        record=record,
        request_rate_hz=request_rate,
        speed=speed,
        system_id=system_id,
        retune=retune,
        zenoh=None if no_zenoh else zenoh,
        outputs=outputs.OutputOptions(
            ros=ros,
            ros_domain=ros_domain,
            send_attitude=send_attitude,
            metrics_port=metrics,
            view=view,
            rrd=rrd,
        ),
        security=security.SecurityOptions(
            security.parse_system_ids(allow_system_ids), signing_key_file
        ),
        second=second,
    )
    return serve(options, verbose=verbose)


def serve(options: RunOptions, *, verbose: bool) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, else 0.

    Raises:
        InputError: a source, profile, file or address that cannot be used.
    """
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
    _require_fitting(options, endpoint)
    outputs.viewer_options(options.outputs.view, options.outputs.rrd)  # refused before compiling
    may_meet_built_in = options.profile is None and endpoint.kind not in ("sim", "log")
    requests = ParameterRequests()
    conflicts: list[InputError] = []
    with ExitStack() as stack:
        # whatever can be refused is opened before the compiler starts, and the source behind it
        session = _open_zenoh(options.zenoh, stack)
        recorder = None if options.record is None else _recorder(options.record, stack)
        retuning = _open_retuning(options, requests, stack)
        pipeline = _pipeline(profile, options, retuning)
        with _closed_if_unused() as sinks:
            sinks.extend(_zenoh_sinks(session, options, profile, requests, conflicts))
            outputs.open_outputs(sinks, options.outputs, session, _prefix(options), profile)
            _compile(profile, options.gain, with_raw=may_meet_built_in)
            sinks.append(_open_view(options, verbose=verbose))  # which prints what the source says
            runner_of = _open_source(endpoint, options, key, recorder, stack)
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
    _report(summary(options, pipeline, runner, seconds, outbox.dropped), as_json=options.as_json)
    for problem in (failure, *conflicts):
        if problem is not None:
            raise problem
    heard = pipeline.vehicles or pipeline.refused_frames  # what is refused has been heard, too
    heard_nobody = not heard and not runner.was_stopped
    return FAILED if heard_nobody and options.seconds is not None else OK


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


def _require_fitting(options: RunOptions, endpoint: "Endpoint") -> None:
    """Refuse options that the source has no use for.

    Raises:
        InputError: names the option.
    """
    live_only = (
        ("--record", options.record),
        ("--request-rate", options.request_rate_hz),
        *options.security.items(),
    )
    if endpoint.kind == "log":
        for option, value in live_only:
            if value is not None:
                raise InputError(f"{option} is for a live vehicle, {endpoint} is a log")
        return
    if options.speed != 1.0:
        raise InputError(f"--speed is for logs, {endpoint} comes at its own pace")
    if endpoint.kind == "sim":
        for option, value in live_only[:2]:
            if value is not None:
                raise InputError(
                    f"{option}: sim: has no MAVLink to record or to ask; start fuzzbee sim --to URL"
                )
    security.require_link(options.security, endpoint)


@contextmanager
def _closed_if_unused() -> "Iterator[list[Sink]]":
    """A list of sinks, of which those that are still in it at an error are closed."""
    sinks: list[Sink] = []
    try:
        yield sinks
    finally:
        for sink in sinks:
            with suppress(Exception):
                sink.close()


def default_profile(endpoint: "Endpoint") -> str:
    """The profile for real IMUs; of the built-in vehicle the one that fits its motion."""
    if endpoint.kind != "sim":
        return DEFAULT_PROFILE
    from drivers.simulation.simulated_vehicle import PROFILES
    from drivers.source import SIM_MOTION

    return PROFILES[endpoint.path or SIM_MOTION]


def _compile(profile: "Profile", gain: float | None, *, with_raw: bool) -> None:
    """Compile before anything is opened; ``with_raw`` also what the paper's raw vectors take."""
    from estimator.compilation.compiled import is_cached
    from estimator.live.resident import advance_raw
    from estimator.profile import load_profile
    from service.warm_up import compile_ahead, warm_up

    done: Future[None] = Future()

    def work() -> None:
        try:
            warm_up(profile, gain)
            if with_raw and is_cached(advance_raw) is False:
                compile_ahead(load_profile("paper"), (advance_raw,))
        except BaseException as error:  # noqa: BLE001 - raised again below
            done.set_exception(error)
        else:
            done.set_result(None)

    # in a thread: the compiler's callbacks swallow what a signal raises in them
    threading.Thread(target=work, name=COMPILER_THREAD, daemon=True).start()
    done.result()


def _open_source(
    endpoint: "Endpoint",
    options: RunOptions,
    key: bytes | None,
    recorder: "Recorder | None",
    stack: ExitStack,
) -> "Callable[[Pipeline, Any, ParameterRequests], Runner]":
    """Open the source; returns the function that makes its runner."""
    from service.overload import Overload
    from service.runner import Runner

    if endpoint.kind == "log":
        return _open_player(endpoint, options, stack)
    from drivers.source import open_live

    policy = security.open_policy(options.security, key, stack)
    source: LiveSource = stack.enter_context(
        open_live(
            endpoint,
            recorder=recorder,
            request_rate_hz=options.request_rate_hz,
            policy=policy,
            key=key,
            references=options.outputs.shows_peers,
        )
    )
    return lambda pipeline, outbox, requests: Runner(
        source,
        pipeline,
        outbox,
        rate_hz=options.rate_hz,
        requests=requests,
        overload=Overload(),
    )


def _recorder(target: str, stack: ExitStack) -> "Recorder":
    """A recorder into a file; or into a folder, if there is one or the name has no suffix."""
    from pathlib import Path

    from drivers.mavlink.recorder import SharedRecorder, TlogRecorder
    from drivers.mavlink.rotating_recorder import RotatingRecorder

    is_file = Path(target).suffix or Path(target).exists()
    if target.endswith("/") or Path(target).is_dir() or not is_file:
        return SharedRecorder(stack.enter_context(RotatingRecorder(target)))
    return SharedRecorder(stack.enter_context(TlogRecorder(target)))


def _open_player(
    endpoint: "Endpoint", options: RunOptions, stack: ExitStack
) -> "Callable[[Pipeline, Any, ParameterRequests], Runner]":
    from pathlib import Path

    from drivers.logs.open import imu_events, open_log
    from service.log_player import LogPlayer
    from service.runner import Runner

    log = stack.enter_context(open_log(Path(endpoint.path)))
    player = LogPlayer(imu_events(log), options.speed)
    return lambda pipeline, outbox, requests: Runner(
        player,
        pipeline,
        outbox,
        rate_hz=options.rate_hz,
        now_us=player.now_us,
        requests=requests,
        is_finished=player.is_finished,
    )


def _open_zenoh(options: "ZenohOptions | None", stack: ExitStack) -> "zenoh.Session | None":
    """A session that is closed whatever happens."""
    if options is None:
        return None
    from service.zenoh_session import close_session, open_session

    session = open_session(options)
    stack.callback(close_session, session)
    return session


def _zenoh_sinks(
    session: "zenoh.Session | None",
    options: RunOptions,
    profile: "Profile",
    requests: "ParameterRequests",
    conflicts: list[InputError],
) -> "list[Sink]":
    if session is None or options.zenoh is None:
        return []
    from service.sinks.zenoh import ZenohSink

    def end(key: str) -> None:
        text = f"another service publishes {key} already: stop it, give one of them another"
        conflicts.append(InputError(f"{text} --prefix, or publish beside it with --second"))

    def tell(key: str) -> None:
        say(f"another service publishes {key}, too")

    on_conflict = tell if options.second else end
    return [ZenohSink(session, options.zenoh.prefix, profile, requests, on_conflict)]


def _prefix(options: RunOptions) -> str:
    from service.zenoh_session import DEFAULT_PREFIX

    return DEFAULT_PREFIX if options.zenoh is None else options.zenoh.prefix


def _open_view(options: RunOptions, *, verbose: bool) -> "TerminalView":
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
        "malformed": pipeline.malformed,
        "refused": dict(sorted(pipeline.refused_frames.items())),
        "vehicles": {
            vehicle.name: {
                "state": vehicle.state.value,
                "motion": vehicle.built_in_motion,
                "imu_message": vehicle.imu_message,
                "imu_rate_hz": round(vehicle.median_rate_hz, 3),
                "worst_gap_s": vehicle.worst_gap_us / 1e6,
                "samples": vehicle.samples,
                "shed": vehicle.shed,
                "attitudes": vehicle.attitudes,
                "rejected": dict(sorted(vehicle.rejected.items())),
            }
            for vehicle in pipeline.vehicles
        },
    }


def _report(result: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        import json

        print(json.dumps(result), flush=True)
        return
    vehicles = result["vehicles"]
    if not vehicles:
        say(f"no vehicle was heard on {result['source']} in {result['seconds']:.1f} s")
        return
    attitudes = sum(vehicle["attitudes"] for vehicle in vehicles.values())
    say(
        f"{attitudes} attitudes of {len(vehicles)} vehicle{'s' * (len(vehicles) != 1)}"
        f" in {result['seconds']:.1f} s, {result['overruns']} overruns"
    )
