"""``fuzzbee calibrate``: what is constantly wrong with an IMU's sensors, from recordings."""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee import outputs

if TYPE_CHECKING:
    from estimator.geometry.earth import PlaceField

UNITS = {"gyr_bias_rad_s": "rad/s", "acc_bias_m_s2": "m/s²", "mag_offset_gauss": "gauss"}
_PROFILE = "imu, adaptive or a TOML file; its own calibration is set aside."
_PLACE = "Where it flew, in degrees. [default: as in the log]"
_OUTPUT = "Write that profile with the calibration found."
_COMPASS = "Which compass, from 0 on. [default: that of the IMU's message]"


class CalibrateOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    logs: list[Path] = typer.Argument(metavar="LOG...", help="Logs of one IMU's turns.")
    output: Path | None = opt.option(_OUTPUT, "-o", "--output")
    profile: str = opt.option(_PROFILE, default="imu")
    place: str | None = opt.option(_PLACE, metavar="LAT,LON")
    system_id: int | None = opt.SYSTEM_ID
    compass: int | None = opt.option(_COMPASS, metavar="0..2")
    begin: str | None = opt.BEGIN
    end: str | None = opt.END
    as_json: bool = opt.JSON


@opt.command(
    "fuzzbee calibrate flight.tlog",
    "fuzzbee calibrate bench1.tlog bench2.tlog -o mine.toml",
    "fuzzbee calibrate flight.bin --from 120 --to 300 > mine.toml",
    "fuzzbee calibrate flight.bin --compass 1",
    "fuzzbee calibrate imu.csv --place 47.40,8.55",
    "fuzzbee calibrate flight.tlog --json",
)
def calibrate(options: CalibrateOptions) -> None:
    """Find what is constantly wrong with an IMU's sensors.

    Biases, scales, crossed axes and iron, each with its sigma, as a profile's [calibration]. To be
    looked at before use: nothing is sent. Ends with 2 if the turns do not show them.
    """
    # A fit's matrices are small: threads of the linear algebra would but wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import msgspec

    from estimator.profile import load_profile, profile_to_toml
    from fuzzbee.calibration_report import report_calibration
    from fuzzbee.notify import notify

    outputs.require_own_files([("--output", options.output)], options.logs)
    field = None if options.place is None else field_there(options.place)
    window = opt.time_window(options.begin, options.end)
    profile = load_profile(options.profile)
    of = (options.system_id, window, options.compass)
    report, refused = report_calibration(options.logs, profile, field, *of)
    for line in refused:
        notify(line)
    if options.output is not None:
        from drivers.output_file import written_for

        calibrated = msgspec.structs.replace(profile, calibration=report["calibration"])
        with written_for("--output", options.output) as path:
            path.write_text(profile_to_toml(calibrated), "utf-8")
    if options.as_json:
        print(msgspec.json.encode(report, enc_hook=lambda array: array.tolist()).decode())
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


def report_lines(report: dict[str, Any]) -> Iterator[str]:
    """A profile's section, with all else in comments."""
    import msgspec

    from estimator.calibration import Calibration
    from tuning.calibration.cross_validation import WON

    has_compass, sensors = "message" in report, report.get("sensors", {"sigma": {}})
    if has_compass:
        yield from _compass_lines(report)
    for key, sigma in sensors["sigma"].items():
        if not has_compass or "mag" not in key:
            size = f"sigma at most {max(sigma):.4f} {UNITS.get(key, '')}".rstrip()
            won = sensors["predicted"].get(key)
            why = "does not predict parts left out" if won is not None else "velocity was reported"
            shows = won is not None and won >= WON
            yield f"# {key}: {size if shows else f'not shown: {why} ({size})'}"
    yield "[calibration]"
    for key, value in msgspec.to_builtins(report["calibration"]).items():
        if value != msgspec.to_builtins(getattr(Calibration(), key)):
            yield f"{key} = {msgspec.json.encode(value).decode()}"
    if report["ardupilot"]:
        adds = ""
        if report.get("ardupilot_adds"):
            how = "add OFS to that" if report["orientation"] is None else "taken for NONE"
            adds = f"; the log does not hold what was set: {how}"
        yield f"# ArduPilot, to be looked at before use{adds}:"
    for name, number in report["ardupilot"].items():
        digits = 0 if "MOTCT" in name or "ORIENT" in name else 1 if "COMPASS_OFS" in name else 4
        yield f"# {name} {number:.{digits}f}"


def _compass_lines(found: dict[str, Any]) -> Iterator[str]:
    before, after = (1e3 * each for each in found["misfit_gauss"])
    sigma = ", ".join(f"{1e3 * each:.1f}" for each in found["offset_sigma_gauss"])
    yield f"# {Path(found['source']).name}: {found['readings']} readings of {found['message']}"
    yield f"# the field there: {1e3 * found['field_gauss']:.0f} mG, dip {found['dip_deg']:.1f} deg"
    yield f"# median misfit: {before:.1f} mG as it is, {after:.1f} mG corrected"
    yield f"# sigma: offset {sigma} mG, of a heading by it {found['heading_sigma_deg']:.1f} deg"
    if found["current_gauss_a"] is not None:
        pairs = zip(found["current_gauss_a"], found["current_sigma_gauss_a"], strict=True)
        each_a = ", ".join(f"{1e3 * each:.2f} (sigma {1e3 * sigma:.2f})" for each, sigma in pairs)
        yield f"# of the battery's current: {each_a} mG for each ampere; below at the usual one"
    if found["matrix_sigma"] is None:
        yield "# soft iron: these turns show none"
    else:
        yield f"# sigma of the matrix: at most {found['matrix_sigma'].max():.3f}"
    if found["orientation"] is not None:
        yield f"# the compass is turned: its orientation should be {found['orientation']}"
        yield "# set that, then calibrate by another flight; the matrix below is for this log"
    if found["unseen"]:
        yield f"# not flown: the field never came within 45 deg of {', '.join(found['unseen'])}"
