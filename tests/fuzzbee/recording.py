"""The recorded flights, and one as arrays."""

from pathlib import Path

import numpy as np

from drivers.events import Imu, ReferenceAttitude, Velocity
from drivers.logs.open import open_log
from drivers.logs.reference_track import ReferenceTrack
from estimator.types import ImuSample

DATA = Path(__file__).parents[1] / "data"
FLIPS = DATA / "sitl_copter_flips.tlog"  # 50 Hz, with the simulator's truth
TAKEOFF = DATA / "sitl_copter_takeoff.tlog"
SLOW = DATA / "sitl_copter_4hz.tlog"
PLANE = DATA / "sitl_plane_4hz.tlog"  # whose autopilot reports a place before it has one


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
