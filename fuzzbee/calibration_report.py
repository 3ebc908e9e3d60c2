"""The figures of ``fuzzbee calibrate``: what is constantly wrong with an IMU's sensors.

One fit of trajectories and constants takes all recordings. A single flight's compass is fitted to
the World Magnetic Model instead, which a stream of any rate allows.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import atan2, cos, degrees, inf
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from drivers.logs.table import blocks
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from drivers.mavlink import ardupilot
from drivers.mavlink.ardupilot import AXES, COMPASS, MOTORS
from drivers.mavlink.constants import MAV_AUTOPILOT_ARDUPILOTMEGA
from estimator.arrays import Floats
from estimator.calibration import UNCHANGED, Calibration, Mounting
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField, in_ned
from estimator.geometry.rotations import rotate_inverse
from estimator.profile import Profile
from estimator.types import DOWN
from fuzzbee.calibration_readings import choose_compass, compass_readings, recording
from fuzzbee.replays.trace import How, VehicleTrace, refused_text, replay_log
from tuning.calibration.cross_validation import WON
from tuning.calibration.fit import SensorFit, fit_sensors
from tuning.compass_fit import CompassFit, fit_compass
from tuning.space import sensor_axes
from tuning.turning import compass_turn

SLOWEST_HZ = 19.0  # turning between the samples of slower streams does not show
UNITS = {"gyr_bias_rad_s": "rad/s", "acc_bias_m_s2": "m/s²", "mag_offset_gauss": "gauss"}
# By ArduPilot's numbers of a compass, as its parameters are known by
NUMBERED = {1: "SCALED_IMU2", 2: "SCALED_IMU3"}


class CalibrationReport(NamedTuple):
    """What all recordings show together.

    ``calibration`` is in the sensors' axes. ``fit`` is None for streams too slow, ``compass`` (as
    ``--json`` has it) where one log's flight does not show it. ``refused`` has a line for each log
    of which much was.
    """

    sources: list[str]
    calibration: Calibration
    ardupilot: dict[str, float]
    fit: SensorFit | None
    compass: dict[str, Any] | None
    refused: list[str]

    def as_json(self) -> dict[str, Any]:
        """The schema of ``calibrate --json``: the compass's figures, and those of all sensors."""
        found = {"source": ", ".join(self.sources), **(self.compass or {})}
        found |= {"calibration": self.calibration, "ardupilot": self.ardupilot}
        if self.fit is not None:
            names = ("sigma", "left", "predicted", "field_misfits", "lags_s")
            found["sensors"] = {name: getattr(self.fit, name) for name in names}
        return found


def report_calibration(
    paths: Sequence[Path],
    profile: Profile,
    field: PlaceField | None = None,
    system_id: int | None = None,
    window: TimeWindow = WHOLE_LOG,
    compass: int | None = None,
) -> CalibrationReport:
    """What the logs of one IMU show of its sensors, in the ``field`` of their place or one given.

    ``compass`` is the number of another compass than the one that the IMU's message has.

    Raises:
        InputError: a log cannot be read, has no such compass, or none of the constants shows.
    """
    plain = msgspec.structs.replace(profile, calibration=Calibration())
    how = How(system_id=system_id, window=window)
    runs = [(path, replay_log(path, plain, how)) for path in paths]
    messages = [choose_compass(*run, plain, compass) for run in runs]
    is_fast = max(trace.step_s or inf for _, trace in runs) < 1.0 / SLOWEST_HZ
    first = runs[0][1]
    way_out = "several logs together need 20 samples a second or more"
    if is_fast:
        way_out = "turn it slowly about all axes, for two minutes or more"
    of_compass, why = None, InputError(f"{paths[0]}: no constant shows: {way_out}")
    if len(paths) == 1:
        try:
            of_compass = _report_compass(paths[0], first, field, messages[0], compass)
        except InputError as error:
            why = error
    fit, parameters, found = None, dict[str, float](), Calibration()
    if is_fast:
        try:
            fit = fit_sensors([recording(*run, field) for run in runs])
        except np.linalg.LinAlgError as error:
            raise InputError(f"{paths[0]}: nothing fits these readings: {error}") from None
        found = fit.found
        parameters = ardupilot.inertial_parameters(first.parameters, first.message, found)
    if of_compass is not None:
        iron = {"mag_matrix": UNCHANGED, **of_compass["calibration"]}
        found = msgspec.structs.replace(found, **iron)
        parameters |= of_compass["ardupilot"]
    if found.is_plain:
        raise why
    if first.kind[0] not in (None, MAV_AUTOPILOT_ARDUPILOTMEGA):
        parameters = {}
    refused = [f"{path}: {text}" for path, trace in runs if (text := refused_text(trace))]
    in_sensor = in_sensor_axes(found, profile.mounting)
    return CalibrationReport([*map(str, paths)], in_sensor, parameters, fit, of_compass, refused)


def _report_compass(
    path: Path, trace: VehicleTrace, field: PlaceField | None, message: str, compass: int | None
) -> dict[str, Any]:
    """What a log's trace shows of its compass, in the ``field`` of its place or of the one given.

    Gauss, body axes. ``calibration`` has the profile's keys, ``ardupilot`` the parameters to set;
    if ``ardupilot_adds``, the log lacks what was set: OFS are to be added to that.
    ``orientation`` is the MAV_SENSOR_ORIENTATION that the compass should have, if another, and
    ``heading_sigma_deg`` what the offset's uncertainty makes of a level vehicle's heading.

    Raises:
        InputError: no position, no compass, or too few turns to find any offset.
    """
    mag, q, there, current_a = compass_readings(path, trace)
    field = field or trace.vehicle.estimator.place_field
    if not len(mag):
        raise InputError(f"{path}: no magnetometer")
    if field is None:
        raise InputError(f"{path}: no position; --place LAT,LON says which field is there")
    turn = compass_turn(mag[there], rotate_inverse(q[there], in_ned(field)))
    mag = mag if turn is None else mag @ turn.T
    down = np.concatenate([rotate_inverse(q[rows], DOWN) for rows in blocks(len(q))])
    fit = fit_compass(mag, down, field, current_a)
    if fit is None:
        raise InputError(
            f"{path}: too few turns to find an offset: fly level through all headings, and tilt"
        )
    number = message if compass is None else NUMBERED.get(compass, "")
    parameters: dict[str, float] = {}
    set_to = None if turn is None else ardupilot.orientation(turn, trace.parameters, number)
    if turn is None:
        irons = fit.offset_gauss, fit.matrix, fit.current_gauss_a
        parameters = ardupilot.corrected(trace.parameters, number, *irons)
        parameters = unmixed(trace.parameters, parameters)
    elif set_to is not None:  # offsets need another flight with it set right
        parameters = {set_to.parameter: float(set_to.value)}
    usual_a = 0.0 if current_a is None else float(current_a.mean())
    horizontal_gauss = field.strength_gauss * cos(field.dip_rad)
    worst_gauss = float(np.linalg.eigvalsh(fit.offset_covariance[:2, :2])[-1]) ** 0.5
    shown = ("current_gauss_a", "current_sigma_gauss_a", "matrix_sigma", "misfit_gauss", "unseen")
    return {
        "message": message,
        "readings": len(mag),
        "field_gauss": field.strength_gauss,
        "dip_deg": degrees(field.dip_rad),
        "offset_sigma_gauss": np.sqrt(np.diag(fit.offset_covariance)),
        **{name: getattr(fit, name) for name in shown},
        "heading_sigma_deg": degrees(atan2(worst_gauss, horizontal_gauss)),
        "calibration": _calibration(fit, usual_a, turn),
        "ardupilot": parameters,
        "ardupilot_adds": not any(name.startswith(COMPASS) for name in trace.parameters),
        "orientation": None if set_to is None else set_to.meaning,
    }


def unmixed(was: Mapping[str, float], parameters: dict[str, float]) -> dict[str, float]:
    """With 0 for what other compasses have for motors, if COMPASS_MOTCT, which all share, changes.

    Else a number by throttle, or one that was not in use, would count for each ampere.
    """
    if parameters.get(MOTORS) in (None, was.get(MOTORS)):
        return parameters
    names = [f"{COMPASS}MOT{number}_{axis}" for number in ("", "2", "3") for axis in AXES]
    return {name: 0.0 for name in names if was.get(name)} | parameters


def _calibration(fit: CompassFit, usual_a: float, turn: Floats | None) -> dict[str, Any]:
    """The profile's keys; it knows no current, so that the usual one's field counts as iron."""
    offset, matrix = fit.offset_gauss, fit.matrix
    if fit.current_gauss_a is not None:
        offset = offset + usual_a * fit.current_gauss_a
    if turn is not None:  # S (R m - b) = S R (m - R^T b)
        offset, matrix = turn.T @ offset, turn if matrix is None else matrix @ turn
    keys = {"mag_offset_gauss": offset.round(5).tolist()}
    return keys if matrix is None else {**keys, "mag_matrix": matrix.round(5).tolist()}


def in_sensor_axes(body: Calibration, mounting: Mounting) -> Calibration:
    """A calibration of readings in the body's axes as one of those in the sensors'."""
    if mounting.has_body_axes:
        return body
    R = sensor_axes(mounting)
    keys: dict[str, Any] = {}
    for key, value in msgspec.to_builtins(body).items():
        sign = mounting.acc_sign if key == "acc_bias_m_s2" else 1
        turned = R.T @ np.array(value) @ R if "matrix" in key else sign * R.T @ np.array(value)
        keys[key] = turned.round(6).tolist()
    return msgspec.convert(keys, Calibration)


def report_lines(report: CalibrationReport) -> Iterator[str]:
    """A profile's section, with all else in comments."""
    compass, fit = report.compass, report.fit
    if compass is not None:
        yield from _compass_lines(Path(report.sources[0]).name, compass)
    for key, sigma in {} if fit is None else fit.sigma.items():
        if fit is not None and (compass is None or "mag" not in key):
            size = f"sigma at most {max(sigma):.4f} {UNITS.get(key, '')}".rstrip()
            won = fit.predicted.get(key)
            why = "does not predict parts left out" if won is not None else "velocity was reported"
            shows = won is not None and won >= WON
            yield f"# {key}: {size if shows else f'not shown: {why} ({size})'}"
    yield "[calibration]"
    for key, value in msgspec.to_builtins(report.calibration).items():
        if value != msgspec.to_builtins(getattr(Calibration(), key)):
            yield f"{key} = {msgspec.json.encode(value).decode()}"
    if report.ardupilot:
        adds = ""
        if compass is not None and compass["ardupilot_adds"]:
            how = "add OFS to that" if compass["orientation"] is None else "taken for NONE"
            adds = f"; the log does not say what was set: {how}"
        yield f"# ArduPilot, to be looked at before use{adds}:"
    for name, number in report.ardupilot.items():
        digits = 0 if "MOTCT" in name or "ORIENT" in name else 1 if "COMPASS_OFS" in name else 4
        yield f"# {name} {number:.{digits}f}"


def _compass_lines(log: str, found: dict[str, Any]) -> Iterator[str]:
    before, after = (1e3 * each for each in found["misfit_gauss"])
    sigma = ", ".join(f"{1e3 * each:.1f}" for each in found["offset_sigma_gauss"])
    yield f"# {log}: {found['readings']} readings of {found['message']}"
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
        yield f"# sigma of the matrix: at most {np.max(found['matrix_sigma']):.3f}"
    if found["orientation"] is not None:
        yield f"# the compass is turned: its orientation should be {found['orientation']}"
        yield "# set that, then calibrate by another flight; the matrix below is for this log"
    if found["unseen"]:
        yield f"# not flown: the field never came within 45 deg of {', '.join(found['unseen'])}"
