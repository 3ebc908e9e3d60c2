"""What ``fuzzbee run`` is asked for."""

from typing import Annotated, NamedTuple

import typer

from fuzzbee import zenoh_options
from fuzzbee.options import PROFILES, Json, Seconds, Verbose, option
from fuzzbee.outputs import OutputOptions
from fuzzbee.security import SecurityOptions
from fuzzbee.zenoh_options import ZenohArguments

_SOURCE = "sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log file."
_PROFILE = (
    "paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own vehicle with the"
    " paper's signals: paper."
)
_RECORD = "Record what arrives: FILE.tlog, or a folder for a file an hour."
_TRUTH = "Compare with what a simulator tells (SIM_STATE, SIMSTATE), and end with a verdict."
RETUNE = "Retune a few numbers whenever the sensors' noise changes."


class RunOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    source: Annotated[str, typer.Argument(help=_SOURCE)] = "sim:"
    rate_hz: Annotated[float, option("Attitudes a second.", "--rate", metavar="HZ")] = 100.0
    seconds: Seconds = None
    profile: Annotated[  # None: the one that fits
        str | None, option(_PROFILE, metavar="NAME|FILE", words=PROFILES)
    ] = None
    gain: Annotated[float | None, option("A fixed gain instead of the fuzzy one.", metavar="K")] = (
        None
    )
    as_json: Json = False
    record: Annotated[str | None, option(_RECORD, metavar="FILE|DIR")] = None
    request_rate_hz: Annotated[
        float | None, option("Ask the vehicle for this IMU rate.", "--request-rate", metavar="HZ")
    ] = None
    speed: Annotated[float, option("Play a log X times as fast.", metavar="X")] = 1.0
    system_id: Annotated[int | None, option("Only this vehicle.", metavar="ID")] = None
    retune: Annotated[bool, option(RETUNE)] = False
    truth: Annotated[bool, option(_TRUTH)] = False
    workers: Annotated[int | None, option("Does nothing any more.", hidden=True)] = None
    security: SecurityOptions = SecurityOptions()
    no_zenoh: Annotated[bool, option("Publish nothing.")] = False
    outputs: OutputOptions = OutputOptions()
    zenoh: ZenohArguments = ZenohArguments()
    second: Annotated[
        bool, zenoh_options.option("Publish even if another service publishes the same vehicle.")
    ] = False
    verbose: Verbose = False
