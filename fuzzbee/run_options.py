"""What ``fuzzbee run`` is asked for."""

from typing import Annotated, NamedTuple

import typer

from fuzzbee import zenoh_options
from fuzzbee.options import (
    PROFILES,
    Json,
    Seconds,
    Verbose,
    of_estimate,
    of_publishing,
    of_recording,
    of_source,
)
from fuzzbee.outputs import OutputOptions
from fuzzbee.security import SecurityOptions
from fuzzbee.zenoh_options import ZenohArguments

_SOURCE = "sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log file."
_PROFILE = (
    "paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own vehicle with the"
    " paper's signals: paper."
)
_RECORD = "Record what arrives: FILE.tlog, or a folder for a file an hour."
_GAIN = "A fixed gain instead of the fuzzy one."
_TRUTH = "Compare with what a simulator tells (SIM_STATE, SIMSTATE), and end with a verdict."
RETUNE = "Retune a few numbers whenever the sensors' noise changes."


class RunOptions(NamedTuple):
    """The arguments and options of the verb; the help has them by panels."""

    source: Annotated[str, typer.Argument(help=_SOURCE)] = "sim:"
    seconds: Seconds = None
    request_rate_hz: Annotated[
        float | None,
        of_source("Ask for this IMU rate.", "--request-rate", metavar="HZ"),
    ] = None
    speed: Annotated[float, of_source("Play a log X times as fast.", metavar="X")] = 1.0
    system_id: Annotated[int | None, of_source("Only this vehicle.", metavar="ID")] = None
    security: SecurityOptions = SecurityOptions()
    profile: Annotated[  # None: the one that fits
        str | None, of_estimate(_PROFILE, metavar="NAME|FILE", words=PROFILES)
    ] = None
    gain: Annotated[float | None, of_estimate(_GAIN, metavar="K")] = None
    retune: Annotated[bool, of_estimate(RETUNE)] = False
    truth: Annotated[bool, of_estimate(_TRUTH)] = False
    rate_hz: Annotated[float, of_publishing("Attitudes a second.", "--rate", metavar="HZ")] = 100.0
    no_zenoh: Annotated[bool, of_publishing("Publish nothing on Zenoh.")] = False
    outputs: OutputOptions = OutputOptions()
    record: Annotated[str | None, of_recording(_RECORD, metavar="FILE|DIR")] = None
    zenoh: ZenohArguments = ZenohArguments()
    second: Annotated[
        bool, zenoh_options.option("Publish even if another service publishes the same vehicle.")
    ] = False
    as_json: Json = False
    verbose: Verbose = False
