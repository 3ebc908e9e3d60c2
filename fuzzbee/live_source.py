"""What ``fuzzbee run`` takes its events from: checked, opened, and its recorder."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.endpoint import Endpoint
from drivers.mavlink.recorder import Recorder
from drivers.player import Player
from drivers.simulation.simulated_vehicle import PROFILES
from drivers.simulation.source import SimSource
from drivers.source import SIM_MOTION, open_live
from estimator.errors import InputError
from fuzzbee import security
from fuzzbee.run import RunOptions
from fuzzbee.sinks import parse_address_of
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.runner import Runner
from service.sinks.sink import Outbox

if TYPE_CHECKING:
    from drivers.mavlink.link import MavlinkLink

DEFAULT_PROFILE = "imu"


def require_fitting(options: RunOptions, endpoint: Endpoint) -> None:
    """Refuse options that the source has no use for."""
    if options.speed != 1.0 and endpoint.kind != "log":
        raise InputError(f"--speed is for logs, {endpoint} comes at its own pace")
    of_link = {"--record": options.record, "--request-rate": options.request_rate_hz}
    asked = [option for option, value in of_link.items() if value is not None]
    checks = [name for name, value in options.security._asdict().items() if value]
    for option in (*asked, *(f"--{name.replace('_', '-')}" for name in checks)):
        if endpoint.kind == "log":
            raise InputError(f"{option} is for a live vehicle, {endpoint} is a log")
        if endpoint.kind == "sim" and option in asked:
            lacks = "sim: has no MAVLink to record or to ask; start fuzzbee sim --to URL"
            raise InputError(f"{option}: {lacks}")
        if endpoint.kind == "sim":
            raise InputError(f"{option} is for a MAVLink link, sim: has no frames")


def default_profile(endpoint: Endpoint) -> str:
    """The profile for real IMUs; of the built-in vehicle the one that fits its motion."""
    if endpoint.kind != "sim":
        return DEFAULT_PROFILE
    return PROFILES[endpoint.path or SIM_MOTION]


def open_source(
    endpoint: Endpoint, options: RunOptions, key: bytes | None, stack: ExitStack
) -> tuple["MavlinkLink | Player", Recorder | None]:
    """Open a link, ``sim:`` or a log that is played; and a link's recorder, if asked for."""
    if endpoint.kind == "log":
        from drivers.logs.open import imu_events, open_log  # which loads every format

        log = stack.enter_context(open_log(Path(endpoint.path)))
        return Player(imu_events(log), options.speed, follow=log.follow), None
    policy = security.open_policy(options.security, key, stack)
    if options.outputs.send_as is not None:
        policy = policy._replace(own=parse_address_of(options.outputs.send_as))
    with ExitStack() as unless_opened:
        recorder = None
        if options.record is not None:
            recorder = stack.enter_context(_recorder(options.record, unless_opened))
        source = open_live(
            endpoint,
            recorder=recorder,
            request_rate_hz=options.request_rate_hz,
            policy=policy,
            key=key,
            references=options.truth or options.outputs.shows_peers,
        )
        stack.enter_context(source)
        unless_opened.pop_all()
    return source, recorder


def _recorder(record: str, unless_opened: ExitStack) -> Recorder:
    """Into a file; or into a folder, if there is one or the name has no suffix."""
    target = Path(record)
    is_new = not target.exists()
    in_folder = record.endswith("/") or target.is_dir() or (is_new and not target.suffix)
    recorder = Recorder(target, in_folder=in_folder)
    if is_new:
        unless_opened.callback(_remove_empty, target)
        unless_opened.callback(recorder.close)
    return recorder


def _remove_empty(target: Path) -> None:
    with suppress(OSError):
        if target.is_dir():
            target.rmdir()
        elif target.stat().st_size == 0:
            target.unlink()


def make_runner(
    source: "MavlinkLink | Player",
    pipeline: Pipeline,
    outbox: Outbox,
    options: RunOptions,
    requests: ParameterRequests,
    recording: Callable[[], str],
) -> Runner:
    """The loop; a log has a clock and an end of its own, a simulated vehicle its seconds."""
    source.follow(pipeline.imu_in_use)
    runner = Runner(
        source,
        pipeline,
        outbox,
        rate_hz=options.rate_hz,
        requests=requests,
        recording=recording,
    )
    if isinstance(source, Player):
        runner.now_us = source.now_us
        runner.is_finished = source.is_finished
    if isinstance(source, SimSource) and (seconds := options.seconds) is not None:
        runner.is_finished = lambda: source.flown_s >= seconds
    return runner
