"""What ``fuzzbee run`` takes its events from: checked, opened, and its recorder."""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from service.runner import Overload, Runner
from service.sinks.sink import Outbox

if TYPE_CHECKING:
    from drivers.mavlink.link import MavlinkLink

DEFAULT_PROFILE = "imu"


def require_fitting(options: RunOptions, endpoint: Endpoint) -> None:
    """Refuse options that the source has no use for."""
    of_link = {"--record": options.record, "--request-rate": options.request_rate_hz}
    asked = [option for option, value in of_link.items() if value is not None]
    checks = options.security.given
    if endpoint.kind == "log":
        for option in (*asked, *checks):
            raise InputError(f"{option} is for a live vehicle, {endpoint} is a log")
        return
    if options.speed != 1.0:
        raise InputError(f"--speed is for logs, {endpoint} comes at its own pace")
    if endpoint.kind == "sim":
        for option in asked:
            raise InputError(
                f"{option}: sim: has no MAVLink to record or to ask; start fuzzbee sim --to URL"
            )
        for option in checks:
            raise InputError(f"{option} is for a MAVLink link, sim: has no frames")


def default_profile(endpoint: Endpoint) -> str:
    """The profile for real IMUs; of the built-in vehicle the one that fits its motion."""
    if endpoint.kind != "sim":
        return DEFAULT_PROFILE
    return PROFILES[endpoint.path or SIM_MOTION]


def open_recorded(
    endpoint: Endpoint, options: RunOptions, key: bytes | None, stack: ExitStack
) -> "tuple[MavlinkLink | Player, Recorder | None]":
    """Open the source and its recorder, if one is asked for.

    It records into a file; or into a folder, if there is one or the name has no suffix.
    """
    target = None if options.record is None else Path(options.record)
    is_new = target is not None and not target.exists()
    recorder = None
    if target is not None:
        in_folder = str(options.record).endswith("/") or target.is_dir()
        in_folder |= is_new and not target.suffix
        recorder = stack.enter_context(Recorder(target, in_folder=in_folder))
    try:
        return open_source(endpoint, options, key, recorder, stack), recorder
    except InputError:
        if target is not None and recorder is not None and is_new:
            recorder.close()
            _remove_empty(target)
        raise


def _remove_empty(target: Path) -> None:
    with suppress(OSError):
        if target.is_dir():
            target.rmdir()
        elif target.stat().st_size == 0:
            target.unlink()


def open_source(
    endpoint: Endpoint,
    options: RunOptions,
    key: bytes | None,
    recorder: Recorder | None,
    stack: ExitStack,
) -> "MavlinkLink | Player":
    """Open a link, ``sim:``, or a log that is played at its own pace or faster."""
    if endpoint.kind == "log":
        from drivers.logs.open import imu_events, open_log  # which loads every format

        log = stack.enter_context(open_log(Path(endpoint.path)))
        return Player(imu_events(log), options.speed, follow=log.follow)
    policy = security.open_policy(options.security, key, stack)
    if options.outputs.send_as is not None:
        policy = policy._replace(own=parse_address_of(options.outputs.send_as))
    source = open_live(
        endpoint,
        recorder=recorder,
        request_rate_hz=options.request_rate_hz,
        policy=policy,
        key=key,
        references=options.truth or options.outputs.shows_peers,
    )
    stack.enter_context(source)
    return source


def make_runner(
    source: "MavlinkLink | Player",
    pipeline: Pipeline,
    outbox: Outbox,
    requests: ParameterRequests,
    options: RunOptions,
    recording: Callable[[], str],
) -> Runner:
    """The loop over a source: a log has a clock and an end of its own.

    So has the vehicle in process, if it is to fly for some seconds.
    """
    more: dict[str, Any] = {"overload": Overload()}
    source.follow(pipeline.imu_in_use)
    if isinstance(source, Player):
        more = {"now_us": source.now_us, "is_finished": source.is_finished}
    if isinstance(source, SimSource) and (seconds := options.seconds) is not None:
        more["is_finished"] = lambda: source.flown_s >= seconds
    return Runner(
        source,
        pipeline,
        outbox,
        rate_hz=options.rate_hz,
        requests=requests,
        recording=recording,
        **more,
    )
