"""A log's compass beside the World Magnetic Model: the part of it in ``fuzzbee calibrate``."""

from collections.abc import Iterator
from math import atan2, cos, degrees, radians
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from drivers.logs.currents import currents
from drivers.logs.open import open_log
from drivers.logs.table import blocks
from drivers.mavlink.ardupilot import Orientation, corrected, orientation
from drivers.mavlink.constants import MAV_AUTOPILOT_ARDUPILOTMEGA
from estimator.arrays import Bools, Floats
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField, in_ned
from estimator.geometry.rotations import rotate_inverse
from estimator.types import DOWN
from fuzzbee.attitudes import PLACE
from fuzzbee.replays.trace import VehicleTrace
from tuning.compass_fit import CompassFit, fit_compass
from tuning.compass_orientation import compass_turn

Rows = list[list[float]]

HEADED_RAD = radians(15.0)  # sigma of a heading that the compass is judged by
SETTLED = 0.1  # of the samples: the estimate has begun by then


class CompassReport(msgspec.Struct, frozen=True):
    """Gauss, body axes.

    ``calibration`` holds the profile's keys, ``ardupilot`` the parameters to set. Where
    ``ardupilot_adds`` the log does not say what was set: its OFS are to be added to that. A compass
    that sits otherwise than set has ``orientation``; ``calibration`` then holds that turn, too.
    ``heading_sigma_deg`` is what the offset's uncertainty makes of a level vehicle's heading.
    """

    source: str
    message: str
    readings: int
    field_gauss: float
    dip_deg: float
    offset_sigma_gauss: list[float]
    current_gauss_a: list[float] | None
    current_sigma_gauss_a: list[float] | None
    matrix_sigma: Rows | None
    heading_sigma_deg: float
    misfit_gauss: tuple[float, float]
    unseen: tuple[str, ...]
    calibration: dict[str, Any]
    ardupilot: dict[str, float]
    ardupilot_adds: bool
    orientation: str | None = None  # MAV_SENSOR_ORIENTATION that it should have, if another


def report_compass(
    path: Path, trace: VehicleTrace, field: PlaceField | None = None
) -> CompassReport:
    """What a log's trace says of its compass, in the ``field`` of its place or of the one given.

    Raises:
        InputError: no position, no compass, or too few turns to find any offset.
    """
    readings = _readings(trace, _current_a(path, trace))
    if not len(readings.mag):
        raise InputError(f"{path}: no magnetometer")
    field = field or trace.place_field
    if field is None:
        raise InputError(f"{path}: no position; --place LAT,LON says which field is there")
    turn = compass_turn(*readings.beside(field))
    mag = readings.mag if turn is None else readings.mag @ turn.T
    current_a = readings.current_a
    fit = fit_compass(mag, readings.down, field, current_a)
    if fit is None:
        raise InputError(
            f"{path}: too few turns to find an offset: fly level through all headings, and tilt"
        )
    message = max(trace.imu_messages, key=lambda name: trace.imu_messages[name])
    is_ardupilot = trace.autopilot in (None, MAV_AUTOPILOT_ARDUPILOTMEGA)
    set_to = None if turn is None else orientation(turn, trace.compass, message)
    return CompassReport(
        source=str(path),
        message=message,
        readings=len(mag),
        field_gauss=field.strength_gauss,
        dip_deg=degrees(field.dip_rad),
        offset_sigma_gauss=np.sqrt(np.diag(fit.offset_covariance)).tolist(),
        current_gauss_a=_listed(fit.current_gauss_a),
        current_sigma_gauss_a=_listed(fit.current_sigma_gauss_a),
        matrix_sigma=None if fit.matrix_sigma is None else fit.matrix_sigma.tolist(),
        heading_sigma_deg=_heading_sigma_deg(fit, field.strength_gauss * cos(field.dip_rad)),
        misfit_gauss=fit.misfit_gauss,
        unseen=fit.unseen,
        calibration=_calibration(fit, 0.0 if current_a is None else float(current_a.mean()), turn),
        ardupilot=_ardupilot(trace, message, fit, turn, set_to) if is_ardupilot else {},
        orientation=None if set_to is None else set_to.meaning,
        ardupilot_adds=not trace.compass,
    )


def _ardupilot(
    trace: VehicleTrace,
    message: str,
    fit: CompassFit,
    turn: Floats | None,
    set_to: Orientation | None,
) -> dict[str, float]:
    """What to set; offsets of a compass that is turned need another flight with it set right."""
    if turn is None:
        return corrected(trace.compass, message, fit.offset_gauss, fit.matrix, fit.current_gauss_a)
    return {} if set_to is None else {set_to.parameter: float(set_to.value)}


def compass_lines(report: CompassReport) -> Iterator[str]:
    """The report as comments of a profile."""
    before, after = (1e3 * each for each in report.misfit_gauss)
    sigma = ", ".join(f"{1e3 * each:.1f}" for each in report.offset_sigma_gauss)
    yield f"# {Path(report.source).name}: {report.readings} readings of {report.message}"
    yield f"# the field there: {1e3 * report.field_gauss:.0f} mG, dip {report.dip_deg:.1f} deg"
    yield f"# median misfit: {before:.1f} mG as it is, {after:.1f} mG corrected"
    yield f"# sigma: offset {sigma} mG, of a heading by it {report.heading_sigma_deg:.1f} deg"
    if report.current_gauss_a is not None and report.current_sigma_gauss_a is not None:
        pairs = zip(report.current_gauss_a, report.current_sigma_gauss_a, strict=True)
        told = ", ".join(f"{1e3 * each:.2f} (sigma {1e3 * sigma:.2f})" for each, sigma in pairs)
        yield f"# of the battery's current: {told} mG for each ampere; below at the usual one"
    if report.matrix_sigma is None:
        yield "# soft iron: these turns show none"
    else:
        yield f"# sigma of the matrix: at most {np.max(report.matrix_sigma):.3f}"
    if report.orientation is not None:
        yield f"# the compass is turned: its orientation should be {report.orientation}"
        yield "# set that, then calibrate by another flight; the matrix below is for this log"
    if report.unseen:
        yield f"# not flown: the field never came within 45 deg of {', '.join(report.unseen)}"


class _Readings(NamedTuple):
    """The field and the vertical (N, 3) in body axes, attitudes (N, 4), and the current (N,).

    ``is_headed`` (N,) shows where velocity has shown the heading.
    """

    mag: Floats
    down: Floats
    q_ned_frd: Floats
    is_headed: Bools
    current_a: Floats | None

    def beside(self, field: PlaceField) -> tuple[Floats, Floats]:
        """Readings where velocity has shown the heading, and the place's field there (M, 3)."""
        there = self.is_headed
        return self.mag[there], rotate_inverse(self.q_ned_frd[there], in_ned(field))


def _readings(trace: VehicleTrace, current_a: Floats | None) -> _Readings:
    """Those of all samples with a field, once the estimate has begun."""
    mag, q = trace["mag_gauss"], trace["q_ned_frd"]
    there = np.flatnonzero(
        trace["has_mag"]
        & mag.any(axis=1)
        & np.isfinite(mag).all(axis=1)
        & np.isfinite(q).all(axis=1)
    )
    there = there[int(SETTLED * len(there)) :]
    is_headed = (
        (trace["sigma_heading_rad"] < HEADED_RAD)
        & (trace["heading_reference"] == PLACE["true"])
        & trace["is_aided"]
    )
    parts = [rotate_inverse(q[there[rows]], DOWN) for rows in blocks(len(there))]
    down = np.concatenate([np.empty((0, 3)), *parts])
    current = None if current_a is None else current_a[there]
    return _Readings(mag[there], down, q[there], is_headed[there], current)


def _current_a(path: Path, trace: VehicleTrace) -> Floats | None:
    """The battery's current (N,) at the samples; None where the log has none."""
    with open_log(path) as log:
        found = currents(log, trace.address.system_id)
    if not found:
        return None
    times_us = [reading.arrival_us for reading in found]
    ampere = [reading.ampere for reading in found]
    return np.asarray(np.interp(trace["arrival_us"], times_us, ampere))


def _listed(values: Floats | None) -> list[float] | None:
    return None if values is None else values.tolist()


def _calibration(fit: CompassFit, usual_a: float, turn: Floats | None) -> dict[str, Any]:
    """The profile's keys; it knows no current, so that the usual one's field counts as iron."""
    offset = fit.offset_gauss
    if fit.current_gauss_a is not None:
        offset = offset + usual_a * fit.current_gauss_a
    matrix = fit.matrix
    if turn is not None:  # S (R m - b) = S R (m - R^T b)
        offset, matrix = turn.T @ offset, turn if matrix is None else matrix @ turn
    keys: dict[str, Any] = {"mag_offset_gauss": offset.round(5).tolist()}
    if matrix is not None:
        keys["mag_matrix"] = matrix.round(5).tolist()
    return keys


def _heading_sigma_deg(fit: CompassFit, horizontal_gauss: float) -> float:
    worst = float(np.linalg.eigvalsh(fit.offset_covariance[:2, :2])[-1]) ** 0.5
    return degrees(atan2(worst, horizontal_gauss))
