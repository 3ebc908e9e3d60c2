"""What ``fuzzbee calibrate`` fits of a replayed log: its IMU, one compass, velocities, current."""

from math import radians
from pathlib import Path

import numpy as np

from drivers.logs.open import open_log
from drivers.logs.other_sensors import compasses, currents
from drivers.logs.table import Table
from drivers.samples.imu_stream import RepeatedField
from estimator.arrays import Bools, Floats
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField, in_ned
from estimator.profile import Profile
from fuzzbee.attitudes import PLACE
from fuzzbee.replays.trace import VELOCITIES, VehicleTrace
from tuning.calibration.spans import Recording

LEAST_S = 10.0  # of a recording
MOST_S = 1200.0  # the stretch that turns most is used
HEADED_RAD = radians(15.0)  # sigma of a heading that the compass is judged by
SETTLED = 0.1  # of the samples: the estimate has begun by then
BESIDE_US = 200_000  # a reading further from every sample belongs to none


def choose_compass(path: Path, trace: VehicleTrace, profile: Profile, number: int | None) -> str:
    """Put the field of another compass into the trace's columns; the name of its message.

    Raises:
        InputError: the log has no such compass.
    """
    if number is None:
        return trace.message
    with open_log(path) as log:
        found = compasses(log, trace.address.system_id)
    known = sorted(found) or ([0] if trace["has_mag"].any() else [])
    if number not in known:
        there = ", ".join(map(str, known)) or "none"
        raise InputError(f"{path}: no compass {number} (there is: {there})")
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


def compass_readings(
    path: Path, trace: VehicleTrace
) -> tuple[Floats, Floats, Bools, Floats | None]:
    """Fields (N, 3) once the estimate has begun, attitudes (N, 4) then, and the current (N,).

    The third (N,) is true where velocity has shown the heading.
    """
    mag, q = trace["mag_gauss"], trace["q_ned_frd"]
    is_known = trace["has_mag"] & mag.any(axis=1) & np.isfinite(mag).all(axis=1)
    there = np.flatnonzero(is_known & np.isfinite(q).all(axis=1))
    there = there[int(SETTLED * len(there)) :]
    is_headed = trace["is_aided"] & (trace["heading_reference"] == PLACE["true"])
    is_headed &= trace["sigma_heading_rad"] < HEADED_RAD
    with open_log(path) as log:
        found = currents(log, trace.address.system_id)
    current_a = None
    if found:
        times_us, amperes = zip(*found, strict=True)
        current_a = np.interp(trace["arrival_us"][there], times_us, amperes)
    return mag[there], q[there], is_headed[there], current_a


def recording(path: Path, trace: VehicleTrace, field: PlaceField | None) -> Recording:
    """The stretch of a trace that turns most, of what the estimate has an attitude for.

    Raises:
        InputError: it is too short to show anything.
    """
    q = trace["q_ned_frd"]
    times_s, gyr = trace.time_s + 1e-6 * trace.zero_us, trace["gyr_rad_s"]
    rows = _liveliest(times_s, gyr, np.isfinite(q[:, 0]))
    first_s, last_s = times_s[rows][[0, -1]]
    if last_s - first_s < LEAST_S:
        raise InputError(f"{path}: shorter than {LEAST_S:g} s")
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
