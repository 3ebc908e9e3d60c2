"""Attitude records for the tests of what is made of them."""

from math import radians

import msgspec

from estimator.geometry.frames import from_euler_rad
from estimator.types import Attitude
from service.publishing import attitude_record
from service.records import Autopilot, State, StatusRecord

UNIX_US = 1_700_000_000_123_456


ATTITUDE = Attitude(
    time_us=1_000_000,
    q_ned_frd=(1.0, 0.0, 0.0, 0.0),
    rate_rad_s=(0.1, 0.2, 0.3),
    gyro_bias_rad_s=(0.01, 0.02, 0.03),
    error=0.01,
    error_rate_1_s=0.1,
    gain=3.0,
    confidence_gravity=1.0,
    confidence_magnetic=0.5,
    sigma_inclination_rad=radians(1.0),
    sigma_heading_rad=radians(5.0),
    heading_reference="true",
)


def record(
    roll_deg=0.0,
    pitch_deg=0.0,
    yaw_deg=0.0,
    *,
    rate_rad_s=(0.1, 0.2, 0.3),
    sigma_deg=(1.0, 5.0),
    sequence=0,
    state=State.RUNNING,
    time_unix_us=UNIX_US,
):
    attitude = ATTITUDE._replace(
        q_ned_frd=from_euler_rad(radians(roll_deg), radians(pitch_deg), radians(yaw_deg)),
        rate_rad_s=rate_rad_s,
        sigma_inclination_rad=radians(sigma_deg[0]),
        sigma_heading_rad=radians(sigma_deg[1]),
    )
    times = {"time_unix_us": time_unix_us, "time_boot_us": attitude.time_us, "age_us": 5_000}
    return attitude_record(attitude, **times, state=state, sequence=sequence)


class Collector:
    """A sink that keeps what it gets."""

    name = "collector"

    def __init__(self):
        self.got, self.closed = [], False

    def handle(self, outputs):
        self.got.extend(outputs)

    def close(self):
        self.closed = True


STATUS = StatusRecord("running", "RAW_IMU", 49.8, 0.1, {}, 0, 0, 3)


def status(state="running", **changes):
    return msgspec.structs.replace(STATUS, state=state, **changes)


def differing(axis="heading", off_deg=25.0, wrong="autopilot", roll_deg=0.0, pitch_deg=0.0):
    """A status of a vehicle whose autopilot has another attitude."""
    off = {"inclination": (off_deg, 1.0), "heading": (0.5, off_deg)}[axis]
    output = Autopilot(
        verdict="differs",
        message="ATTITUDE",
        for_s=8.0,
        inclination_deg=off[0],
        heading_deg=off[1],
        inclination_sigmas=off[0],
        heading_sigmas=off[1] / 2.0,
        wrong=wrong,
        evidence="the magnetic field is 0 deg off ours and 25 off the autopilot's",
        axis=axis,
        roll_deg=roll_deg,
        pitch_deg=pitch_deg,
    )
    return status(warnings=("autopilot_differs",), autopilot=output)
