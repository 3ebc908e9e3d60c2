"""``fuzzbee calibrate``: what iron in the vehicle does to its compass, from a flight."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from fuzzbee.options import Json, command, examples, option

_PROFILE = "imu, adaptive or a TOML file; its own iron is set aside."
_SYSTEM_ID = "Which vehicle. [default: the one with most IMU samples]"

EPILOG = examples(
    "fuzzbee calibrate flight.tlog",
    "fuzzbee calibrate flight.bin > mine.toml",
    "fuzzbee calibrate flight.tlog --json",
)


class CalibrateOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log with a position.")]
    profile: Annotated[str, option(_PROFILE)] = "imu"
    system_id: Annotated[int | None, option(_SYSTEM_ID)] = None
    as_json: Json = False


@command
def calibrate(options: CalibrateOptions) -> None:
    """Find hard and soft iron by a flight's turns; print them for a profile and for ArduPilot.

    To be looked at before use: nothing is sent. Ends with 2 if the turns do not show them.
    """
    import msgspec

    from estimator.profile import load_profile
    from fuzzbee.compass_report import report_compass, toml_lines

    report = report_compass(options.log, load_profile(options.profile), options.system_id)
    if options.as_json:
        print(msgspec.json.encode(report).decode())
    else:
        print("\n".join(toml_lines(report)))
