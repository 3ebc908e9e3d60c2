"""``fuzzbee run``: the live service."""

from collections import namedtuple
from contextlib import nullcontext
from typing import Annotated, Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.options import (
    PROFILES,
    Json,
    Retune,
    Seconds,
    Verbose,
    ZenohArguments,
    command,
    examples,
    of_estimate,
    of_publishing,
    of_recording,
    of_source,
    of_zenoh,
    opening,
    require_gain,
    require_positive,
)
from fuzzbee.security import SecurityOptions, parse_system_ids

MAX_RATE_HZ = 1000.0

EPILOG = examples(
    "fuzzbee run sim:flight",
    "fuzzbee run udpin:127.0.0.1:14550 --rate 50",
    "fuzzbee run /dev/ttyUSB0:57600 --request-rate 50 --record flight.tlog",
    "fuzzbee run flight.tlog --speed 4",
    "fuzzbee run tcp:127.0.0.1:5760 -m client -e tcp/192.168.1.10:7447",
)

_SOURCE = "sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log file."
_PROFILE = (
    "paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own vehicle with the"
    " paper's signals: paper."
)
_RECORD = "Record what arrives: FILE.tlog, or a folder for a file an hour."
_GAIN = "A fixed gain instead of the fuzzy one."
_TRUTH = "Compare with a simulator's truth (SIM_STATE, SIMSTATE), and end with a verdict."


_OF_SINKS = {name: each for entry in outputs.SINKS for name, each in entry.options.items()}
_OF_SINKS |= {"view": (outputs.View, None), "rrd": (outputs.Rrd, None)}
_DEFAULTS = [default for _, default in _OF_SINKS.values()]
_new: Any = namedtuple  # noqa: PYI024 - the names are those of a table


class OutputOptions(_new("_Options", _OF_SINKS, defaults=_DEFAULTS)):  # type: ignore[misc]
    """What was asked for: for each option of :data:`fuzzbee.outputs.SINKS` a field, and two."""

    __slots__ = ()
    __annotations__ = {name: kind for name, (kind, _) in _OF_SINKS.items()}


class RunOptions(NamedTuple):
    """The arguments and options of the verb; the help has them by panels."""

    source: Annotated[str, typer.Argument(help=_SOURCE)] = "sim:"
    seconds: Seconds = None
    request_rate_hz: Annotated[
        float | None, of_source("Ask for this IMU rate.", "--request-rate", metavar="HZ")
    ] = None
    speed: Annotated[float, of_source("Play a log X times as fast.", metavar="X")] = 1.0
    system_id: Annotated[
        int | None, of_source("Only this vehicle.", metavar="ID", min=1, max=255)
    ] = None
    security: SecurityOptions = SecurityOptions()
    profile: Annotated[  # None: the one that fits
        str | None, of_estimate(_PROFILE, metavar="NAME|FILE", words=PROFILES)
    ] = None
    gain: Annotated[float | None, of_estimate(_GAIN, metavar="K")] = None
    retune: Retune = False
    truth: Annotated[bool, of_estimate(_TRUTH)] = False
    rate_hz: Annotated[float, of_publishing("Attitudes a second.", "--rate", metavar="HZ")] = 100.0
    no_zenoh: Annotated[bool, of_publishing("Publish nothing on Zenoh.")] = False
    outputs: OutputOptions = OutputOptions()
    record: Annotated[str | None, of_recording(_RECORD, metavar="FILE|DIR")] = None
    zenoh: ZenohArguments = ZenohArguments()
    second: Annotated[
        bool, of_zenoh("Publish even if another service publishes the same vehicle.")
    ] = False
    as_json: Json = False
    verbose: Verbose = False


@command
def run(options: RunOptions) -> int:
    """Estimate attitudes live and publish them."""
    require_positive("--rate", options.rate_hz)
    if options.rate_hz > MAX_RATE_HZ:
        raise InputError(f"--rate {options.rate_hz:g}: should be at most {MAX_RATE_HZ:g}")
    require_positive("--seconds", options.seconds)
    require_positive("--request-rate", options.request_rate_hz)
    require_positive("--speed", options.speed)
    require_gain(options.gain)
    if options.outputs.send_as is not None and options.outputs.send_attitude is None:
        raise InputError(f"--as {options.outputs.send_as}: needs --send-attitude URL")
    parse_system_ids(options.security.allow_system_ids)
    asked = (("--record", options.record), ("--rrd", options.outputs.rrd))
    inputs = (options.source, options.profile, options.security.signing_key_file)
    outputs.require_own_files(asked, (*inputs, options.zenoh.config_file))
    with nullcontext() if options.no_zenoh else opening(options.zenoh) as session:
        from fuzzbee.serve import serve

        return serve(options, session)
