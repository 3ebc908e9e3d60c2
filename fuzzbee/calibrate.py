"""``fuzzbee calibrate``: what is constantly wrong with an IMU's sensors, from recordings."""

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt

if TYPE_CHECKING:
    from estimator.geometry.earth import PlaceField

_PROFILE = "imu, adaptive or a TOML file; its own calibration is set aside."
_PLACE = "Where it flew, in degrees. [default: what the log says]"
_OUTPUT = "Write that profile with the calibration found."
_SYSTEM_ID = "Which vehicle. [default: the one with most IMU samples]"
_COMPASS = "Which compass, from 0 on. [default: that of the IMU's message]"

EPILOG = opt.examples(
    "fuzzbee calibrate flight.tlog",
    "fuzzbee calibrate bench1.tlog bench2.tlog -o mine.toml",
    "fuzzbee calibrate flight.bin --from 120 --to 300 > mine.toml",
    "fuzzbee calibrate flight.bin --compass 1",
    "fuzzbee calibrate imu.csv --place 47.40,8.55",
    "fuzzbee calibrate flight.tlog --json",
)


class CalibrateOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    logs: list[Path] = typer.Argument(metavar="LOG...", help="Logs of one IMU's turns.")
    output: Path | None = opt.option(_OUTPUT, "-o", "--output", metavar="FILE")
    profile: str = opt.option(_PROFILE, default="imu")
    place: str | None = opt.option(_PLACE, metavar="LAT,LON")
    system_id: int | None = opt.option(_SYSTEM_ID)
    compass: int | None = opt.option(_COMPASS, metavar="0..2")
    begin: str | None = opt.BEGIN
    end: str | None = opt.END
    as_json: bool = opt.JSON


@opt.command
def calibrate(options: CalibrateOptions) -> None:
    """Find what is constantly wrong with an IMU's sensors.

    Biases, scales, crossed axes and iron, each with its sigma, as a profile's [calibration]. To be
    looked at before use: nothing is sent. Ends with 2 if the turns do not show them.
    """
    # A fit's matrices are small: threads of the linear algebra would but wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import msgspec

    from estimator.profile import load_profile, profile_to_toml
    from fuzzbee.calibration_report import report_calibration, report_lines
    from fuzzbee.notify import notify

    field = None if options.place is None else field_there(options.place)
    window = opt.time_window(options.begin, options.end)
    profile = load_profile(options.profile)
    report = report_calibration(
        options.logs, profile, field, options.system_id, window, options.compass
    )
    for line in report.refused:
        notify(line)
    if options.output is not None:
        from drivers.output_file import written_whole

        calibrated = msgspec.structs.replace(profile, calibration=report.calibration)
        with written_whole(options.output) as path:
            path.write_text(profile_to_toml(calibrated), "utf-8")
    if options.as_json:
        print(msgspec.json.encode(report.as_json(), enc_hook=lambda array: array.tolist()).decode())
    else:
        print("\n".join(report_lines(report)))


def field_there(place: str) -> "PlaceField":
    """The Earth's field at LAT,LON (degrees) today: a compass does not show what years change.

    Raises:
        InputError: no two numbers, or no place where a field has a direction.
    """
    from estimator.geometry.earth import field_at

    try:
        latitude_deg, longitude_deg = map(float, place.split(","))
    except ValueError:
        raise InputError(f"--place {place!r}: should be LAT,LON, such as 47.40,8.55") from None
    field = field_at(latitude_deg, longitude_deg, 0.0, time.time_ns() // 1000)
    if field is None or abs(longitude_deg) > 360.0:
        raise InputError(f"--place {place}: latitude -89.9 to 89.9, longitude -360 to 360 degrees")
    return field
