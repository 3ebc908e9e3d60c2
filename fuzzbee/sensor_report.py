"""The figures of ``fuzzbee calibrate``: what is constantly wrong with an IMU's sensors."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from drivers.events import Parameter, Velocity
from drivers.logs.open import open_log
from drivers.logs.time_window import WHOLE_LOG, TimeWindow, WindowedEvents
from drivers.mavlink.ardupilot import INERTIAL, ORIENTATION, inertial_parameters
from drivers.mavlink.constants import MAV_AUTOPILOT_ARDUPILOTMEGA
from estimator.arrays import Bools, Floats
from estimator.calibration import UNCHANGED, Calibration
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField, in_ned
from estimator.geometry.quaternion import rotate
from estimator.mounting import Mounting
from estimator.profile import Profile
from fuzzbee.compass_report import CompassReport, compass_lines, report_compass
from fuzzbee.replays.log_report import replay_log
from fuzzbee.replays.trace import VehicleTrace
from tuning.calibration.fit import SensorFit, fit_sensors
from tuning.calibration.spans import Recording

SLOWEST_HZ = 19.0  # turning between the samples of slower streams does not show
LEAST_S, MOST_S = 10.0, 1200.0  # of a recording, of which the stretch that turns most is used
UNSHOWN = 0.3  # of the variance before
UNITS = {"gyr_bias_rad_s": "rad/s", "acc_bias_m_s2": "m/s²", "mag_offset_gauss": "gauss"}


class SensorReport(NamedTuple):
    """What all recordings show together.

    ``calibration`` is in the sensors' axes. ``fit`` is None for streams too slow, ``compass``
    where one log's flight does not show it.
    """

    sources: list[str]
    calibration: Calibration
    ardupilot: dict[str, float]
    fit: SensorFit | None
    compass: CompassReport | None

    def as_json(self) -> dict[str, Any]:
        """The schema of ``calibrate --json``: the compass's figures, and those of all sensors."""
        told: dict[str, Any] = {} if self.compass is None else msgspec.to_builtins(self.compass)
        told |= {"source": ", ".join(self.sources)}
        told |= {"calibration": msgspec.to_builtins(self.calibration), "ardupilot": self.ardupilot}
        if self.fit is not None:
            names = ("sigma", "left", "field_misfits", "lags_s")
            told["sensors"] = {name: getattr(self.fit, name) for name in names}
        return told


class _Told(NamedTuple):
    """What else a log says: velocities (M, 3) with times (M,), and the IMU's parameters."""

    time_us: Floats
    velocity_ned_m_s: Floats
    parameters: dict[str, float]


def report_sensors(
    paths: Sequence[Path],
    profile: Profile,
    field: PlaceField | None = None,
    system_id: int | None = None,
    window: TimeWindow = WHOLE_LOG,
) -> SensorReport:
    """What the logs of one IMU show of its sensors, in the ``field`` of their place or one given.

    Raises:
        InputError: a log cannot be read, or none of the constants shows.
    """
    plain = msgspec.structs.replace(profile, calibration=Calibration())
    traces = [replay_log(path, plain, system_id=system_id, window=window) for path in paths]
    is_fast = min(_rate_hz(trace) for trace in traces) > SLOWEST_HZ
    way_out = "turn it slowly about all axes, for two minutes or more"
    if not is_fast:
        way_out = "several logs together need 20 samples a second or more"
    compass, why = None, InputError(f"{paths[0]}: no constant shows: {way_out}")
    if len(paths) == 1:
        try:
            compass = report_compass(paths[0], traces[0], field)
        except InputError as error:
            why = error
    fit, ardupilot = None, {}
    if is_fast:
        told = [_told(*each, window) for each in zip(paths, traces, strict=True)]
        fit = _fit(traces, told, field, paths[0])
        if traces[0].autopilot in (None, MAV_AUTOPILOT_ARDUPILOTMEGA):
            ardupilot = inertial_parameters(told[0].parameters, _message(traces[0]), fit.found)
    found = Calibration() if fit is None else fit.found
    if compass is not None:
        iron = {"mag_matrix": UNCHANGED, **compass.calibration}
        found = msgspec.structs.replace(found, **iron)
        ardupilot |= compass.ardupilot
    elif fit is None:
        raise why
    if found.is_plain:
        raise why
    found = in_sensor_axes(found, profile.mounting)
    return SensorReport([str(path) for path in paths], found, ardupilot, fit, compass)


def report_lines(report: SensorReport) -> Iterator[str]:
    """A profile's section, with all else in comments."""
    if report.compass is not None:
        yield from compass_lines(report.compass)
    for name, sigma in {} if report.fit is None else report.fit.sigma.items():
        if report.compass is None or "mag" not in name:
            yield _sigma_line(report, name, sigma)
    yield "[calibration]"
    for key, value in msgspec.to_builtins(report.calibration).items():
        if value != msgspec.to_builtins(getattr(Calibration(), key)):
            yield f"{key} = {msgspec.json.encode(value).decode()}"
    if report.ardupilot:
        yield f"# ArduPilot, to be looked at before use{_adds(report)}:"
    for name, number in report.ardupilot.items():
        digits = 0 if "MOTCT" in name or "ORIENT" in name else 1 if "COMPASS_OFS" in name else 4
        yield f"# {name} {number:.{digits}f}"


def _sigma_line(report: SensorReport, name: str, sigma: list[float]) -> str:
    """How sure a key is, or that it does not show."""
    assert report.fit is not None
    unit = UNITS.get(name, "")
    shows = report.fit.left[name] < UNSHOWN
    size = f"sigma at most {max(sigma):.4f} {unit}".rstrip()
    return f"# {name}: {size}" if shows else f"# {name}: not shown ({size}): as before where so"


def _adds(report: SensorReport) -> str:
    if report.compass is None or not report.compass.ardupilot_adds:
        return ""
    if report.compass.orientation is not None:
        return "; the log does not say what was set: taken for NONE"
    return "; the log does not say what was set: add OFS to that"


def in_sensor_axes(body: Calibration, mounting: Mounting) -> Calibration:
    """A calibration of readings in the body's axes as one of those in the sensors'."""
    if mounting.has_body_axes:
        return body
    q = mounting.q_frd_sensor
    R = np.column_stack([rotate(q, axis) for axis in UNCHANGED])
    keys: dict[str, Any] = {}
    for key, value in msgspec.to_builtins(body).items():
        sign = mounting.acc_sign if key == "acc_bias_m_s2" else 1
        turned = R.T @ np.array(value) @ R if "matrix" in key else sign * R.T @ np.array(value)
        keys[key] = turned.round(6).tolist()
    return msgspec.convert(keys, Calibration)


def _rate_hz(trace: VehicleTrace) -> float:
    steps_us = np.diff(trace["time_us"])
    return 1e6 / float(np.median(steps_us)) if len(steps_us) else 0.0


def _message(trace: VehicleTrace) -> str:
    return trace.imu_messages.most_common(1)[0][0]


def _fit(
    traces: list[VehicleTrace], told: list[_Told], field: PlaceField | None, path: Path
) -> SensorFit:
    recordings = [_recording(*each, field) for each in zip(traces, told, strict=True)]
    if max(each.time_s[-1] - each.time_s[0] for each in recordings) < LEAST_S:
        raise InputError(f"{path}: shorter than {LEAST_S:g} s")
    try:
        return fit_sensors(recordings)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{path}: nothing fits these readings: {error}") from None


def _recording(trace: VehicleTrace, told: _Told, field: PlaceField | None) -> Recording:
    """The stretch of a trace that turns most, of what the estimate has an attitude for."""
    q = trace["q_ned_frd"]
    times_s, gyr = trace.time_s + 1e-6 * trace.zero_us, trace["gyr_rad_s"]
    rows = _liveliest(times_s, gyr, np.isfinite(q[:, 0]))
    mag = trace["mag_gauss"][rows]
    place = field or trace.place_field
    inside = (told.time_us >= 1e6 * times_s[rows][0]) & (told.time_us <= 1e6 * times_s[rows][-1])
    return Recording(
        times_s[rows],
        gyr[rows],
        trace["acc_m_s2"][rows],
        mag,
        trace["has_mag"][rows] & mag.any(axis=1),
        q[rows],
        1e-6 * told.time_us[inside],
        told.velocity_ned_m_s[inside],
        None if place is None else np.array(in_ned(place)),
    )


def _liveliest(times_s: Floats, gyr: Floats, known: Bools) -> slice:
    """The ``MOST_S`` that turn most, behind the first row with an attitude."""
    first = int(np.argmax(known))
    ends = np.searchsorted(times_s, times_s + MOST_S) - 1
    turned = np.concatenate([[0.0], np.cumsum((gyr**2).sum(axis=1))])
    begin = first + int(np.argmax(turned[ends[first:]] - turned[first : len(ends)]))
    if times_s[-1] - times_s[first] <= MOST_S:
        begin = first
    return slice(begin, int(ends[begin]) + 1)


def _told(path: Path, trace: VehicleTrace, window: TimeWindow) -> _Told:
    """The velocities of the message that shows most, and the IMU's parameters."""
    velocities, parameters = [], {}
    with open_log(path) as log:
        for event in log if window == WHOLE_LOG else WindowedEvents(log, window):
            match event:
                case Velocity(vehicle=address) if address == trace.address:
                    velocities.append(event)
                case Parameter(vehicle=address, name=name, value=value) if (
                    address == trace.address and name.startswith((INERTIAL, ORIENTATION))
                ):
                    parameters[name] = value
    most = Counter(each.message for each in velocities).most_common(1)
    chosen = [each.sample for each in velocities if each.message == most[0][0]]
    times_us = np.array([each.time_us for each in chosen], dtype=float)
    order = np.argsort(times_us, kind="stable")
    vectors = np.array([each.velocity_ned_m_s for each in chosen], dtype=float).reshape(-1, 3)
    return _Told(times_us[order], vectors[order], parameters)
