"""Everything that can arrive from a source, as immutable values.

Every event but the link's own names the vehicle it came from and carries
``arrival_us``, the host's Unix time in microseconds when its bytes arrived
(for logs: the log's stamp). Where the message carries the vehicle's time,
``time_us`` is that time on the continuous vehicle clock described in
``estimator.types``.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from estimator.types import ImuSample, Quaternion, VelocitySample


class VehicleId(NamedTuple):
    """MAVLink address of a vehicle: system id and autopilot component id."""

    system_id: int
    component_id: int


@dataclass(frozen=True, slots=True)
class Imu:
    """One IMU message. ``boot_us`` is the vehicle's own unwrapped boot clock."""

    vehicle: VehicleId
    arrival_us: int
    boot_us: int
    message: (
        str  # "RAW_IMU", "SCALED_IMU2", "HIGHRES_IMU", "IMU" (DataFlash), "sensor_combined" ...
    )
    sample: ImuSample


@dataclass(frozen=True, slots=True)
class ReferenceAttitude:
    """Somebody else's attitude: the autopilot's estimate, or a simulator's truth."""

    vehicle: VehicleId
    arrival_us: int
    time_us: int
    source: Literal["autopilot", "sim"]
    message: str
    q_ned_frd: Quaternion


@dataclass(frozen=True, slots=True)
class Velocity:
    """Velocity over ground, from the message named."""

    vehicle: VehicleId
    arrival_us: int
    message: str
    sample: VelocitySample


@dataclass(frozen=True, slots=True)
class Position:
    """Geodetic position (WGS 84) from a fix that the message itself calls valid."""

    vehicle: VehicleId
    arrival_us: int
    time_us: int
    message: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class Parameter:
    """One PARAM_VALUE."""

    vehicle: VehicleId
    arrival_us: int
    name: str
    value: float


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A HEARTBEAT with MAV_AUTOPILOT and MAV_TYPE as numbers."""

    vehicle: VehicleId
    arrival_us: int
    autopilot: int
    vehicle_type: int


@dataclass(frozen=True, slots=True)
class CommandAck:
    """The vehicle's answer (MAV_RESULT) to a command of ours."""

    vehicle: VehicleId
    arrival_us: int
    command: int
    result: int


@dataclass(frozen=True, slots=True)
class ClockReset:
    """The vehicle's clock began anew; the samples after it belong to another stretch of time."""

    vehicle: VehicleId
    arrival_us: int
    reason: Literal["reboot", "jump"]
    step_s: float  # how far the vehicle's own clock moved, signed


@dataclass(frozen=True, slots=True)
class Rejected:
    """A sample that a check refused; ``reason`` is a short snake_case word to count under.

    ``message`` names the stream it came in, as in ``Imu``: a zero second IMU
    says nothing about the first.
    """

    vehicle: VehicleId
    arrival_us: int
    reason: str
    message: str = ""


@dataclass(frozen=True, slots=True)
class RefusedFrames:
    """Frames that were not let in; the address is what they claim, which nobody has proven."""

    vehicle: VehicleId
    arrival_us: int
    reason: str
    frames: int


@dataclass(frozen=True, slots=True)
class Notice:
    """Something a person should be told once, in one line."""

    vehicle: VehicleId | None
    arrival_us: int
    text: str


@dataclass(frozen=True, slots=True)
class Malformed:
    """Bytes that were no readable MAVLink frame."""

    arrival_us: int
    frames: int


@dataclass(frozen=True, slots=True)
class LinkUp:
    """The link to the named endpoint works (again)."""

    arrival_us: int
    endpoint: str


@dataclass(frozen=True, slots=True)
class LinkDown:
    """The link broke, with the reason a person can act on."""

    arrival_us: int
    endpoint: str
    reason: str


Event = (
    Imu
    | ReferenceAttitude
    | Velocity
    | Position
    | Parameter
    | Heartbeat
    | CommandAck
    | ClockReset
    | Rejected
    | RefusedFrames
    | Notice
    | Malformed
    | LinkUp
    | LinkDown
)
