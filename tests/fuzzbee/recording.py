"""The recorded flights, one as arrays, logs with other messages in them, and tables."""

from pathlib import Path

import numpy as np

from drivers.events import Imu, ReferenceAttitude, Velocity
from drivers.logs.log_file import windowed
from drivers.logs.open import open_log
from drivers.logs.reference_track import ReferenceTrack
from drivers.logs.tlog import tlog_records
from drivers.mavlink.constants import mavlink
from drivers.mavlink.framing import parsed
from drivers.simulation.simulated_vehicle import SimulatedVehicle, imu_errors
from estimator.types import ImuSample

DATA = Path(__file__).parents[1] / "data"
FLIPS = DATA / "sitl_copter_flips.tlog"  # 50 Hz, with the simulator's truth
TAKEOFF = DATA / "sitl_copter_takeoff.tlog"
SLOW = DATA / "sitl_copter_4hz.tlog"
PLANE = DATA / "sitl_plane_4hz.tlog"  # whose autopilot reports a place before it has one
G = 9.80665  # m/s^2
WITH_TRUTH = 'axes = "frd"\ntruth = { columns = ["w", "x", "y", "z"] }'  # of a table


def recorded(path):
    """Times (N,), gyr, acc, mag, velocity (N, 3; NaN where none came) and truth of a log."""
    rows, velocities, truth, waiting = [], [], ReferenceTrack(), None
    with open_log(path) as log:
        for event in log:
            match event:
                case Velocity(message="GLOBAL_POSITION_INT"):
                    waiting = event.sample.velocity_ned_m_s
                case Imu(message="RAW_IMU", sample=sample):
                    rows.append(sample)
                    velocities.append(waiting or (np.nan,) * 3)
                    waiting = None
                case ReferenceAttitude(source="sim"):
                    truth.add(event)
    times_us = np.array([row.time_us for row in rows])
    parts = (np.array([getattr(row, name) for row in rows]) for name in ImuSample._fields[1:4])
    return (1e-6 * times_us, *parts, np.array(velocities), truth.at(times_us))


def table(path, rate_hz, rows, columns=()):
    """A table of rows (gyroscope, accelerometer, other columns) at times."""
    heading = ["time_s", "gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_g", "ay_g", "az_g", *columns]
    lines = [",".join(map(str, (k / rate_hz, *row))) for k, row in enumerate(rows) if row]
    path.write_text("\n".join([",".join(heading), *lines]))
    return path


def bench(path, seed, motion="bench", seconds=120.0, rate_hz=50.0, errors=None):
    """A table of a simulated vehicle whose sensors have the constant errors of a seed; 0: none."""
    errors_seed = (seed if errors is None else errors) or None
    vehicle = SimulatedVehicle(seed, rate_hz, motion, bias=0.0, errors_seed=errors_seed)
    samples = [next(vehicle) for _ in range(round(seconds * rate_hz))]
    path.with_suffix(".toml").write_text(f"compass_calibrated = true\n{WITH_TRUTH}")
    rows = [(*s.gyr_rad_s, *np.divide(s.acc_m_s2, G), *s.mag_gauss, *s.q_ned_frd) for s in samples]
    return table(path, rate_hz, rows, ("mx_gauss", "my_gauss", "mz_gauss", *"wxyz"))


def truth_of(seed):
    """[calibration] that undoes the errors of a seed."""
    reported, names = {}, ("gyr_bias_rad_s", "acc_bias_m_s2", "mag_offset_gauss")
    for name, (matrix, bias) in zip(names, imu_errors(seed), strict=True):
        reported |= {name: bias, f"{name[:3]}_matrix": np.linalg.inv(matrix)}
    return reported


def frames_of(log):
    """Arrival and bytes of each frame of a telemetry log."""
    with windowed(log) as window:
        return [(us, bytes(each.data)) for us, each in filter(None, tlog_records(window))]


def rewritten(log, made, change):
    """A copy of a log; ``change(seconds, message)`` gives messages for each, or None for itself."""
    data, first_us = bytearray(), None
    for stamp_us, frame in frames_of(log):
        first_us = stamp_us if first_us is None else first_us
        message = parsed(frame)
        given = change(1e-6 * (stamp_us - first_us), message)
        frames = [frame]
        if given is not None:
            link = mavlink().MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
            link.seq = message.get_seq()
            frames = [each.pack(link) for each in given]
        for each in frames:
            data += stamp_us.to_bytes(8, "big") + bytes(each)
    made.write_bytes(data)
    return made


def with_iron(log, made, offset_mgauss, matrix=None, left_out=(), current_mgauss_a=None):
    """A copy of a log in which every RAW_IMU's field m is matrix^-1 m + offset.

    Messages of the types ``left_out`` are not in it. With ``current_mgauss_a`` its SYS_STATUS has a
    current that rises and falls by 10 to 30 A, slower than messages of a few hertz can follow; it
    adds so much to the field for each ampere.
    """
    back = np.linalg.inv(np.eye(3) if matrix is None else matrix)
    mgauss_a = np.zeros(3) if current_mgauss_a is None else np.array(current_mgauss_a)

    def change(seconds, m):
        ampere, kind = 20.0 + 10.0 * np.sin(seconds / 7.0), m.get_type()
        if kind in left_out:
            return []
        if kind == "RAW_IMU":
            field = back @ (m.xmag, m.ymag, m.zmag) + offset_mgauss + ampere * mgauss_a
            m.xmag, m.ymag, m.zmag = (round(each) for each in field)
        elif kind == "SYS_STATUS" and current_mgauss_a is not None:
            m.current_battery = round(100.0 * ampere)
        else:
            return None
        return [m]

    return rewritten(log, made, change)
