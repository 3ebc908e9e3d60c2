"""What ``fuzzbee run`` takes its events from: checked, opened, and its recorder."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from estimator.errors import InputError
from fuzzbee import security
from fuzzbee.run_options import RunOptions

if TYPE_CHECKING:
    from drivers.endpoint import Endpoint
    from drivers.mavlink.recorder import Recorder
    from drivers.mavlink.taker import FrameTaker
    from drivers.source import LiveSource
    from service.parameters import ParameterRequests
    from service.pipeline import Pipeline
    from service.runner import Runner

DEFAULT_PROFILE = "imu"


def require_fitting(options: RunOptions, endpoint: "Endpoint") -> None:
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


def default_profile(endpoint: "Endpoint") -> str:
    """The profile for real IMUs; of the built-in vehicle the one that fits its motion."""
    if endpoint.kind != "sim":
        return DEFAULT_PROFILE
    from drivers.simulation.simulated_vehicle import PROFILES
    from drivers.source import SIM_MOTION

    return PROFILES[endpoint.path or SIM_MOTION]


def open_source(
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
    source = open_link(endpoint, options, key, recorder, stack)
    return lambda pipeline, outbox, requests: Runner(
        source,
        pipeline,
        outbox,
        rate_hz=options.rate_hz,
        requests=requests,
        overload=Overload(),
    )


def open_link(
    endpoint: "Endpoint",
    options: RunOptions,
    key: bytes | None,
    recorder: "Recorder | None",
    stack: ExitStack,
    taker: "FrameTaker | None" = None,
) -> "LiveSource":
    """Open a link, or ``sim:``. With a ``taker`` the frames are its own, and what is asked for."""
    from drivers.source import open_live

    policy = security.open_policy(options.security, key, stack)
    return stack.enter_context(
        open_live(
            endpoint,
            recorder=recorder,
            request_rate_hz=options.request_rate_hz if taker is None else None,
            policy=policy,
            key=key,
            references=options.outputs.shows_peers,
            taker=taker,
        )
    )


def open_recorder(target: str, stack: ExitStack) -> "Recorder":
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
