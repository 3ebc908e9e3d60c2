"""Everything that can arrive from a source, as immutable values.

Every event but the link's own names the vehicle it came from and carries ``arrival_us``, the host's
Unix time in microseconds when its bytes arrived (for logs: the log's stamp). Where the message
carries the vehicle's time, ``time_us`` is that time on the continuous vehicle clock described in
``estimator.types``.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import msgspec

from estimator.reasons import Reason
from estimator.types import ImuSample, Quaternion, RateSample, Vec3, VelocitySample


class Value(msgspec.Struct, frozen=True, gc=False):
    """The base of immutable values that are made thousands of times a second.

    One is made in 0.1 us, a tenth of a dataclass or named tuple. The garbage collector does not
    look into them: a value may hold numbers, texts, tuples and other values, but nothing that could
    lead back to it.
    """


class VehicleId(NamedTuple):
    """MAVLink address of a vehicle: system id and autopilot component id."""

    system_id: int
    component_id: int


# The IMU message that is used of a vehicle; None where it is not known.
ImuInUse = Callable[[VehicleId], str | None]


class VehicleEvent(Value, frozen=True):
    """Something of one vehicle; ``arrival_us`` is when its bytes arrived."""

    vehicle: VehicleId
    arrival_us: int


class Imu(VehicleEvent, frozen=True):
    """One IMU message. ``boot_us`` is the vehicle's own unwrapped boot clock."""

    boot_us: int
    message: str  # "RAW_IMU", "HIGHRES_IMU", "IMU" (DataFlash), "sensor_combined" (ULog) ...
    sample: ImuSample


class OtherImu(VehicleEvent, frozen=True):
    """What an IMU beside the one in use reads (rad/s, m/s², FRD), now and then."""

    message: str
    rate_rad_s: Vec3
    force_m_s2: Vec3


class ReferenceAttitude(VehicleEvent, frozen=True):
    """Somebody else's attitude: the autopilot's estimate, or a simulator's truth."""

    time_us: int
    source: Literal["autopilot", "sim"]
    message: str
    q_ned_frd: Quaternion


class Report(VehicleEvent, frozen=True):
    """What something beside the IMU has measured, to help the estimate.

    ``sample`` is of a type that :meth:`estimator.estimator.Estimator.update_report` takes. A new
    type needs no event of its own.
    """

    message: str
    sample: Any


class BodyRates(Report, frozen=True):
    """Body rates by another messenger than the IMU's own: ATTITUDE's, less the autopilot's bias."""

    sample: RateSample


class Velocity(Report, frozen=True):
    """Velocity over ground, from the message named."""

    sample: VelocitySample


class Position(VehicleEvent, frozen=True):
    """Geodetic position (WGS 84) from a fix that the message itself calls valid."""

    time_us: int
    message: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


# The name of a parameter by which a log's description has the compass calibrated, 1, or not, 0.
COMPASS_CALIBRATED = "compass_calibrated"


class Parameter(VehicleEvent, frozen=True):
    """One PARAM_VALUE."""

    name: str
    value: float


class Heartbeat(VehicleEvent, frozen=True):
    """A HEARTBEAT with MAV_AUTOPILOT and MAV_TYPE as numbers."""

    autopilot: int
    vehicle_type: int
    is_armed: bool | None = None  # None: the log does not report it
    custom_mode: int | None = None  # the flight mode's number, by autopilot and type


class ModeChange(VehicleEvent, frozen=True):
    """Arming or flight mode, as in ``Heartbeat``, of a log that has no heartbeats."""

    is_armed: bool | None = None
    custom_mode: int | None = None


class StatusText(VehicleEvent, frozen=True):
    """A line of the vehicle's for a person, with its MAV_SEVERITY; of telemetry logs."""

    severity: int
    text: str


class BuiltIn(VehicleEvent, frozen=True):
    """The vehicle is fuzzbee's own, and makes this motion."""

    motion: str


class FilterStatus(VehicleEvent, frozen=True):
    """What the vehicle's navigation filter reports of itself; a ratio is 1 at its gate."""

    has_velocity: bool
    has_place: bool
    velocity_ratio: float = 0.0
    has_attitude: bool = True
    compass_ratio: float = 0.0


class CommandAck(VehicleEvent, frozen=True):
    """The vehicle's answer (MAV_RESULT) to a command of ours."""

    command: int
    result: int


class ClockReset(VehicleEvent, frozen=True):
    """The vehicle's clock began anew; the samples after it belong to another stretch of time.

    They do not where it only leapt and time ``goes_on``.
    """

    reason: Literal["reboot", "jump"]
    step_s: float  # how far the vehicle's own clock moved, signed
    goes_on: bool = False  # by the arrivals: then nothing is lost but the leap


class TrackLost(VehicleEvent, frozen=True):
    """A sensor was blind for so long that nobody knows how far the vehicle turned meanwhile.

    ``message`` names its stream, ``reason`` is why its samples were refused. The
    next sample of that stream is good again.
    """

    message: str
    reason: Reason
    blind_s: float


class Rejected(VehicleEvent, frozen=True):
    """A sample that a check refused; counted under its ``reason``.

    ``message`` names the stream it came in, as in ``Imu``: a second IMU of
    zeros shows nothing about the first.
    """

    reason: Reason
    message: str = ""


class Shed(VehicleEvent, frozen=True):
    """Samples of one stream that were left out, since newer ones were there already."""

    message: str
    samples: int


class Forgotten(VehicleEvent, frozen=True):
    """A silent sender's place was given to another: its clock is not known any more.

    Whatever else is remembered of it belongs to that clock. If it comes back it is a new one.
    """


class RefusedFrames(VehicleEvent, frozen=True):
    """Frames that were not let in; the address is what they claim, which nobody has proven."""

    reason: Reason
    frames: int


class Notice(Value, frozen=True):
    """Something a person should see once, in one line.

    ``section`` names the section of the profile that settles it, if one does.
    """

    vehicle: VehicleId | None
    arrival_us: int
    text: str
    section: Literal["", "mounting"] = ""


class Malformed(Value, frozen=True):
    """Bytes that were no readable MAVLink frame."""

    arrival_us: int
    frames: int


class LinkUp(Value, frozen=True):
    """The link to the named endpoint works (again)."""

    arrival_us: int
    endpoint: str


class LinkDown(Value, frozen=True):
    """The link broke, with the reason a person can act on."""

    arrival_us: int
    endpoint: str
    reason: str


Event = VehicleEvent | Notice | Malformed | LinkUp | LinkDown
