"""What the service publishes: attitudes and statuses, whose numbers are all finite.

Field names and order are the JSON schema. Angles are in degrees here because
people and maps read these records; everything inside is in radians. Bounds are
those of what is shown of records that come from the network.
"""

from enum import StrEnum
from math import log, radians, sqrt
from typing import Annotated

import msgspec
from msgspec import Meta

from drivers.events import Value, VehicleId
from drivers.mavlink.constants import MAV_COMP_ID_AUTOPILOT1
from estimator.profile import Profile
from estimator.types import ImuSample, Quaternion

SCHEMA = 1
# 68 % of the lengths of two equal normal errors are below this many standard deviations.
RAYLEIGH_68 = sqrt(-2.0 * log(1.0 - 0.68))


class State(StrEnum):
    """What the published attitude is worth."""

    WAITING = "waiting"  # a frame of the vehicle has come, but no IMU sample has come yet
    ALIGNING = "aligning"  # IMU data arrive, no attitude yet
    RUNNING = "running"  # attitude from fresh data
    DEGRADED = "degraded"  # attitude, extrapolated: the IMU is silent
    LOST = "lost"  # silent for so long that no attitude is published


HAS_ATTITUDE = frozenset({State.RUNNING, State.DEGRADED})


Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
Vector = tuple[Number, Number, Number]
StateWord = Annotated[str, Meta(pattern=rf"^({'|'.join(State)})\Z")]
HeadingReference = Annotated[str, Meta(pattern=r"^(true|magnetic|none)\Z")]
ImuMessage = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_/:.-]{1,64}\Z")]  # or a topic of a bag
Mode = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_ .:/-]{0,32}\Z")]


class Confidence(Value, frozen=True):
    """The paper's s_i as they count at this moment."""

    gravity: Number
    magnetic: Number


class Sigma(Value, frozen=True):
    """Angles that 68 % of the errors lie under."""

    inclination: Number
    heading: Number


class AttitudeRecord(Value, frozen=True):
    """One published attitude. ``time_boot_us`` is the same instant on the vehicle's boot clock."""

    schema: int
    time_unix_us: int
    time_boot_us: int
    q_ned_frd: tuple[Number, Number, Number, Number]
    euler_deg: tuple[Angle, Angle, Angle]  # roll, pitch, yaw; yaw in [0, 360)
    rate_rad_s: Vector
    gyro_bias_rad_s: Vector
    error: Annotated[float, Meta(ge=0.0, le=1.0)]
    error_rate: Number
    gain: Annotated[float, Meta(ge=0.0, le=1e7)]
    confidence: Confidence
    sigma_deg: Sigma
    heading_reference: HeadingReference
    state: StateWord
    age_ms: Annotated[float, Meta(ge=0.0, le=1e12)]
    sequence: int

    @property
    def variances_rad2(self) -> tuple[float, float]:
        """Of the inclination about each of its two axes, and of the heading.

        The length of two equal normal errors is Rayleigh distributed. The heading has one error:
        68 % of it lies under 0.99 standard deviations, taken as one.
        """
        inclination_rad = radians(self.sigma_deg.inclination) / RAYLEIGH_68
        return inclination_rad**2, radians(self.sigma_deg.heading) ** 2


class Retuned(Value, frozen=True):
    """How often a profile has been retuned by itself, and the last change."""

    count: int
    last: str


class Autopilot(Value, frozen=True):
    """The autopilot's attitude beside ours; see :mod:`service.second_opinion`."""

    verdict: str  # "agrees", "differs" or "cannot_tell"
    message: str  # that its attitude comes from
    for_s: Number  # the verdict stands
    inclination_deg: Number  # between the two
    heading_deg: Number  # by how much the autopilot's is clockwise of ours
    inclination_sigmas: Number  # the same by our sigma
    heading_sigmas: Number
    wrong: str  # "autopilot", "ours", or "" where nothing shows which
    evidence: str
    axis: str = ""  # in which they differ: "inclination" or "heading"
    roll_deg: Number = 0.0  # by how much the autopilot's is more than ours
    pitch_deg: Number = 0.0

    @property
    def off_deg(self) -> float:
        """How far they differ, in the axis in which they do."""
        return self.inclination_deg if self.axis == "inclination" else abs(self.heading_deg)

    @property
    def sigma_deg(self) -> float:
        """Our sigma in that axis."""
        sigmas = self.inclination_sigmas if self.axis == "inclination" else self.heading_sigmas
        return self.off_deg / max(sigmas, 0.1)

    @property
    def in_short(self) -> str:
        """The axis and by how much, for places with little room."""
        what = "horizon" if self.axis == "inclination" else self.axis or "attitude"
        return f"autopilot {what} {self.off_deg:.0f}° off"


class ImuDifference(Value, frozen=True):
    """How another IMU differs from the one in use, on average over ten seconds."""

    inclination_deg: Number  # between the specific forces
    rate_deg_s: Number  # between the angular rates


class StatusRecord(msgspec.Struct, frozen=True):
    """How the estimate of one vehicle is doing, once a second."""

    state: StateWord
    imu_message: ImuMessage | None
    imu_rate_hz: Annotated[float, Meta(ge=0.0, le=1e6)]
    worst_gap_s: Number
    rejected: dict[str, int]
    overruns: int
    dropped: int
    sequence: int
    rates: str = "imu"  # "imu+attitude" once ATTITUDE has shown turning between IMU samples
    gain: str = ""  # what sets K, in words
    overloaded: bool = False  # more arrives than can be handled: samples are left out
    shed: int = 0  # samples of this vehicle left out so far
    lost: int = 0  # datagrams of all vehicles that the system threw away before they could be read
    published_hz: Number = 0.0  # attitudes a second, fewer than ``--rate`` when overloaded
    malformed: int = 0  # unreadable frames on the vehicle's link so far, by any sender
    warnings: tuple[str, ...] = ()  # words of service.alarms.Alarm
    retuned: Retuned | None = None  # by itself, with --retune
    autopilot: Autopilot | None = None  # None where it sends no attitude
    recording: str = ""  # "whole", "failed", or "" where nothing is recorded
    mode: Mode = ""  # the flight mode's name; "" where the vehicle does not report it
    armed: bool | None = None  # None where the vehicle does not report it
    # by message; empty where there is one IMU
    other_imus: Annotated[dict[ImuMessage, ImuDifference], Meta(max_length=32)] = {}
    compass_off_deg: Angle | None = None  # its own heading less ours; None without one


class Published(Value, frozen=True):
    """A record and the vehicle it is about; with an attitude, the sample it comes from.

    ``time_unix_us`` is when a status was made, which does not have it itself. ``peers`` are
    somebody else's attitudes, by "autopilot" or "sim", for those who show them beside ours.
    """

    vehicle: VehicleId
    record: AttitudeRecord | StatusRecord
    sample: ImuSample | None = None
    time_unix_us: int = 0
    peers: tuple[tuple[str, Quaternion], ...] = ()


class Replaced(Value, frozen=True):
    """A vehicle's parameters have been replaced, by these; ``retuned`` is why, if by itself."""

    vehicle: VehicleId
    profile: Profile
    retuned: str | None = None


class Evicted(Value, frozen=True):
    """A vehicle is forgotten: nothing of it is published any more, unless it comes back."""

    vehicle: VehicleId


class Message(Value, frozen=True):
    """One line for a person."""

    text: str


Output = Published | Replaced | Evicted | Message


def vehicle_name(vehicle: VehicleId) -> str:
    """The key's middle part: the system id, or ``S-C`` if the component is not the autopilot."""
    if vehicle.component_id == MAV_COMP_ID_AUTOPILOT1:
        return str(vehicle.system_id)
    return f"{vehicle.system_id}-{vehicle.component_id}"
