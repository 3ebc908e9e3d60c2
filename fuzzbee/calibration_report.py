"""The figures of ``fuzzbee calibrate``: what is constantly wrong with an IMU's sensors.

One fit of trajectories and constants takes all recordings. A single flight's compass is fitted to
the World Magnetic Model instead, which a stream of any rate allows.
"""

from collections.abc import Mapping, Sequence
from math import atan2, cos, degrees, inf, radians
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drivers.logs.other_sensors import compasses, currents
from drivers.logs.table import Table, blocks
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from drivers.mavlink import ardupilot
from drivers.mavlink.ardupilot import AXES, COMPASS, MOTORS
from drivers.mavlink.constants import MAV_AUTOPILOT_ARDUPILOTMEGA
from drivers.samples.imu_stream import RepeatedField
from estimator.calibration import UNCHANGED, Calibration, Mounting
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField, in_ned
from estimator.geometry.rotations import rotate_inverse
from estimator.profile import Profile
from estimator.types import DOWN, Bools, Floats
from fuzzbee.attitudes import PLACE
from fuzzbee.replays.trace import VELOCITIES, How, VehicleTrace, replay_log
from tuning.calibration.fit import fit_sensors
from tuning.calibration.spans import Recording
from tuning.compass_fit import CompassFit, fit_compass
from tuning.space import sensor_axes
from tuning.turning import compass_turn

SLOWEST_HZ = 19.0  # turning between the samples of slower streams does not show
LEAST_S = 10.0  # of a recording
MOST_S = 1200.0  # the stretch that turns most is used
HEADED_RAD = radians(15.0)  # sigma of a heading that the compass is judged by
SETTLED = 0.1  # of the samples: the estimate has begun by then
BESIDE_US = 200_000  # a reading further from every sample belongs to none
# By ArduPilot's numbers of a compass, as its parameters are known by
NUMBERED = {1: "SCALED_IMU2", 2: "SCALED_IMU3"}


def report_calibration(
    paths: Sequence[Path],
    profile: Profile,
    field: PlaceField | None = None,
    system_id: int | None = None,
    window: TimeWindow = WHOLE_LOG,
    compass: int | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """What the logs of one IMU show of its sensors, in the ``field`` of their place or one given.

    ``compass`` is the number of another compass than the one that the IMU's message has. The result
    is what ``calibrate --json`` prints, and a line for each log of which much was refused. Its
    ``calibration`` is in the sensors' axes. It has ``sensors`` of fast streams only, and the
    compass's figures only of one log whose flight shows them.

    Raises:
        InputError: a log cannot be read, has no such compass, or none of the constants shows.
    """
    plain = msgspec.structs.replace(profile, calibration=Calibration())
    how = How(system_id=system_id, window=window)
    traces = [replay_log(path, plain, how) for path in paths]
    messages = [choose_compass(trace, plain, compass) for trace in traces]
    is_fast = max(trace.step_s or inf for trace in traces) < 1.0 / SLOWEST_HZ
    first = traces[0]
    way_out = "several logs together need 20 samples a second or more"
    if is_fast:
        way_out = "turn it slowly about all axes, for two minutes or more"
    of_compass, why = dict[str, Any](), InputError(f"{paths[0]}: no constant shows: {way_out}")
    if len(paths) == 1:
        try:
            of_compass = _report_compass(first, field, messages[0], compass)
        except InputError as error:
            why = error
    sensors, parameters, found = dict[str, Any](), dict[str, float](), Calibration()
    if is_fast:
        try:
            fit = fit_sensors([recording(trace, field) for trace in traces])
        except np.linalg.LinAlgError as error:
            raise InputError(f"{paths[0]}: nothing fits these readings: {error}") from None
        found = fit.found
        names = ("sigma", "left", "predicted", "field_misfits", "lags_s")
        sensors = {"sensors": {name: getattr(fit, name) for name in names}}
        parameters = ardupilot.inertial_parameters(first.parameters, first.message, found)
    if of_compass:
        iron = {"mag_matrix": UNCHANGED, **of_compass["calibration"]}
        found = msgspec.structs.replace(found, **iron)
        parameters |= of_compass["ardupilot"]
    if found.is_plain:
        raise why
    if first.kind[0] not in (None, MAV_AUTOPILOT_ARDUPILOTMEGA):
        parameters = {}
    refused = [f"{trace.log.path}: {trace.refused}" for trace in traces if trace.refused]
    report = {"source": ", ".join(map(str, paths)), **of_compass}
    report |= {"calibration": in_sensor_axes(found, profile.mounting), "ardupilot": parameters}
    return report | sensors, refused


def _report_compass(
    trace: VehicleTrace, field: PlaceField | None, message: str, compass: int | None
) -> dict[str, Any]:
    """What a log's trace shows of its compass, in the ``field`` of its place or of the one given.

    Gauss, body axes.

    Raises:
        InputError: no position, no compass, or too few turns to find any offset.
    """
    mag, q, there, current_a = compass_readings(trace)
    path, field = trace.log.path, field or trace.vehicle.estimator.place_field
    if not len(mag):
        raise InputError(f"{path}: no magnetometer")
    if field is None:
        raise InputError(f"{path}: no position; --place LAT,LON gives it")
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
        # of a level vehicle, by the offset's uncertainty
        "heading_sigma_deg": degrees(atan2(worst_gauss, horizontal_gauss)),
        "calibration": _calibration(fit, usual_a, turn),
        "ardupilot": parameters,  # to set
        # the log lacks what was set: OFS are to be added to that
        "ardupilot_adds": not any(name.startswith(COMPASS) for name in trace.parameters),
        "orientation": None if set_to is None else set_to.meaning,  # to set, if it is another
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


# --- what is fitted of a replayed log: its IMU, one compass, velocities, current


def choose_compass(trace: VehicleTrace, profile: Profile, number: int | None) -> str:
    """Put the field of another compass into the trace's columns; the name of its message.

    Raises:
        InputError: the log has no such compass.
    """
    if number is None:
        return trace.message
    found = compasses(trace.log, trace.address.system_id)
    known = sorted(found) or ([0] if trace["has_mag"].any() else [])
    if number not in known:
        there = ", ".join(map(str, known)) or "none"
        raise InputError(f"{trace.log.path}: no compass {number} (there is: {there})")
    if number not in found:
        return trace.message
    message, arrivals_us, mag = found[number]
    samples_us = trace["arrival_us"]
    rows = np.searchsorted(0.5 * (samples_us[1:] + samples_us[:-1]), arrivals_us)  # the nearest
    used = RepeatedField().fresh_rows(mag, arrivals_us)
    used &= np.abs(samples_us[rows] - arrivals_us) <= BESIDE_US
    columns, has_mag = np.zeros((len(samples_us), 3)), np.zeros(len(samples_us), np.bool_)
    columns[rows[used]], has_mag[rows[used]] = mag[used], True
    _, _, columns = profile.to_body_rows(0.0 * columns, 0.0 * columns, columns)
    trace.put("mag_gauss", [columns])
    trace.put("has_mag", [has_mag])
    return message


def compass_readings(trace: VehicleTrace) -> tuple[Floats, Floats, Bools, Floats | None]:
    """Fields (N, 3) once the estimate has begun, attitudes (N, 4) then, and the current (N,).

    The third (N,) is true where velocity has shown the heading.
    """
    mag, q = trace["mag_gauss"], trace["q_ned_frd"]
    is_known = trace["has_mag"] & mag.any(axis=1) & np.isfinite(mag).all(axis=1)
    there = np.flatnonzero(is_known & np.isfinite(q).all(axis=1))
    there = there[int(SETTLED * len(there)) :]
    is_headed = trace["is_aided"] & (trace["heading_reference"] == PLACE["true"])
    is_headed &= trace["sigma_heading_rad"] < HEADED_RAD
    found = currents(trace.log, trace.address.system_id)
    current_a = None
    if found:
        times_us, amperes = zip(*found, strict=True)
        current_a = np.interp(trace["arrival_us"][there], times_us, amperes)
    return mag[there], q[there], is_headed[there], current_a


def recording(trace: VehicleTrace, field: PlaceField | None) -> Recording:
    """The stretch of a trace that turns most, of what the estimate has an attitude for.

    Raises:
        InputError: it is too short to show anything.
    """
    q = trace["q_ned_frd"]
    times_s, gyr = trace.time_s + 1e-6 * trace.zero_us, trace["gyr_rad_s"]
    rows = _liveliest(times_s, gyr, np.isfinite(q[:, 0]))
    first_s, last_s = times_s[rows][[0, -1]]
    if last_s - first_s < LEAST_S:
        raise InputError(f"{trace.log.path}: shorter than {LEAST_S:g} s")
    most = max(trace.velocities.values(), key=len, default=Table(**VELOCITIES))  # by message
    order = np.argsort(most["time_us"], kind="stable")
    at_s = 1e-6 * most["time_us"][order]
    within = (at_s >= first_s) & (at_s <= last_s)
    mag, place = trace["mag_gauss"][rows], field or trace.vehicle.estimator.place_field
    return Recording(
        times_s[rows],
        gyr[rows],
        trace["acc_m_s2"][rows],
        mag,
        trace["has_mag"][rows] & mag.any(axis=1),
        q[rows],
        at_s[within],
        most["velocity_ned_m_s"][order][within],
        None if place is None else np.array(in_ned(place)),
    )


def _liveliest(times_s: Floats, gyr: Floats, known: Bools) -> slice:
    """The ``MOST_S`` that turn most, behind the first row with an attitude."""
    first = int(np.argmax(known))
    ends = np.searchsorted(times_s, times_s + MOST_S) - 1
    turned = np.concatenate([[0.0], np.cumsum((gyr**2).sum(axis=1))])
    begin = first + int(np.argmax(turned[ends[first:]] - turned[first : len(ends)]))
    return slice(begin, int(ends[begin]) + 1)
