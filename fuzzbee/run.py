"""``fuzzbee run``: the live service."""

from collections import namedtuple
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee import outputs

MAX_RATE_HZ = 1000.0

_SOURCE = "sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log file."
_REQUEST = "Ask for this IMU rate."
_ALLOW = "Refuse frames of all other systems: 1,2,10-19."
_KEY = "Refuse frames not signed with the key (32 bytes, 64 hex digits) or phrase there."
_PROFILE = (
    "paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own vehicle with the"
    " paper's signals: paper."
)
_TRUTH = "Compare with a simulator's truth (SIM_STATE, SIMSTATE), and end with a verdict."
_RECORD = "Record what arrives: FILE.tlog, or a folder for a file an hour."
_SECOND = "Publish even if another service publishes the same vehicle."

_OF_SINKS = {name: each for entry in outputs.SINKS for name, each in entry.options.items()}
_OF_SINKS |= {"view": (str | None, outputs.VIEW), "rrd": (str | None, outputs.RRD)}
_INFOS = [info for _, info in _OF_SINKS.values()]
# A field for each option of the sinks, and two
OutputOptions: Any = namedtuple("OutputOptions", _OF_SINKS, defaults=_INFOS)  # type: ignore[misc]  # noqa: PYI024
OutputOptions.__annotations__ = {name: kind for name, (kind, _) in _OF_SINKS.items()}


class RunOptions(NamedTuple):
    """The arguments and options of the verb; the help has them by panels."""

    source: str = typer.Argument("sim:", help=_SOURCE)
    seconds: float | None = opt.SECONDS
    request_rate_hz: float | None = opt.source(_REQUEST, "--request-rate", metavar="HZ")
    speed: float = opt.source("Play a log X times as fast.", default=1.0, metavar="X")
    system_id: int | None = opt.source("Only this vehicle.", metavar="ID", min=1, max=255)
    allow_system_ids: str | None = opt.source(_ALLOW, metavar="IDS")
    signing_key_file: Path | None = opt.source(_KEY)
    insecure_key_file: bool = opt.source(opt.INSECURE, default=False)
    profile: str | None = opt.estimate(_PROFILE, metavar="NAME|FILE", words=opt.PROFILES)
    gain: float | None = opt.estimate("A fixed gain instead of the fuzzy one.", metavar="K")
    retune: bool = opt.RETUNE
    truth: bool = opt.estimate(_TRUTH, default=False)
    rate_hz: float = opt.publishing("Attitudes a second.", "--rate", default=100.0, metavar="HZ")
    no_zenoh: bool = opt.publishing("Publish nothing on Zenoh.", default=False)
    outputs: Any = OutputOptions()
    record: str | None = opt.recording(_RECORD, metavar="FILE|DIR")
    zenoh: opt.ZenohArguments = opt.ZenohArguments()
    second: bool = opt.of_zenoh(_SECOND, default=False)
    as_json: bool = opt.JSON
    verbose: bool = opt.VERBOSE


@opt.command(
    "fuzzbee run sim:flight",
    "fuzzbee run udpin:127.0.0.1:14550 --rate 50",
    "fuzzbee run /dev/ttyUSB0:57600 --request-rate 50 --record flight.tlog",
    "fuzzbee run flight.tlog --speed 4",
    "fuzzbee run tcp:127.0.0.1:5760 -m client -e tcp/192.168.1.10:7447",
)
def run(options: RunOptions) -> int:
    """Estimate attitudes live and publish them."""
    opt.require_positive(options, "rate_hz", "seconds", "request_rate_hz", "speed")
    if options.rate_hz > MAX_RATE_HZ:
        raise InputError(f"--rate {options.rate_hz:g}: should be at most {MAX_RATE_HZ:g}")
    if options.outputs.send_as is not None and options.outputs.send_attitude is None:
        raise InputError(f"--as {options.outputs.send_as}: needs --send-attitude URL")
    asked = (("--record", options.record), ("--rrd", options.outputs.rrd))
    inputs = (options.source, options.profile, options.signing_key_file)
    outputs.require_own_files(asked, (*inputs, options.zenoh.config_file))
    with nullcontext() if options.no_zenoh else opt.opening(options.zenoh) as session:
        from fuzzbee.serve import serve

        return serve(options, session)
