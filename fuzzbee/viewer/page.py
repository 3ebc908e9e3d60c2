"""One vehicle's page in the viewer: horizon, bodies and curves.

Of what is given, only what is due is drawn: see the rates below.
"""

from collections.abc import Callable
from math import degrees, hypot, nan
from typing import NamedTuple

from estimator.geometry.quaternion import angle_between, exp, multiply, rotate, scale
from estimator.profile import Profile
from estimator.types import ImuSample, Quaternion, Vec3
from fuzzbee.trust import WORDS, Level, is_on_its_back, trust
from fuzzbee.viewer import bodies, layout
from fuzzbee.viewer.curves import Curves
from fuzzbee.viewer.horizon import COLOURS, Scene, frame, layers
from fuzzbee.viewer.layer import Layer
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import ViewerStream
from service.alarms import Alarm
from service.attitude_record import euler_deg
from service.health import HAS_ATTITUDE, State
from service.records import AttitudeRecord, Peer, StatusRecord

# Pictures a second: of one vehicle, and of all together.
PICTURES_HZ = 4.0
ALL_PICTURES_HZ = 6.0
FIGURES_EVERY = 2  # pictures: digits that change more often cannot be read; the bodies with them
WORDS_EVERY = 4  # pictures; at once if the state or the trust has changed
POINTS_HZ = 10.0  # of a curve; they go in batches
PEER_SILENT_US = 2_000_000  # an older attitude of somebody else's is not drawn any more
FAST_RAD_S = 0.9  # 50 deg/s: a degree in the 20 ms that two messages are apart
FIELD_SILENT_US = 1_000_000
TOLD_EVERY_US = 1_000_000  # how trust changes is told once a second at most
PEERS = ("autopilot", "sim")
UNKNOWN: Vec3 = (nan, nan, nan)
STATE_COLOURS = {
    State.WAITING: (150, 150, 150),
    State.ALIGNING: (80, 170, 220),
    State.RUNNING: COLOURS[Level.GOOD],
    State.DEGRADED: COLOURS[Level.CARE],
    State.LOST: COLOURS[Level.BAD],
}


class Heard(NamedTuple):
    """The latest attitude by somebody else, and when it was one: None until the next of ours."""

    peer: Peer
    at_us: int | None = None


class Page:
    """What is drawn of the vehicle ``name``, and what has to be remembered for it.

    ``say`` takes lines for a person. With ``is_live`` attitudes of others come late.
    """

    def __init__(
        self,
        name: str,
        stream: ViewerStream,
        say: Callable[[str], None],
        profile: Profile,
        *,
        is_live: bool,
    ) -> None:
        self.profile = profile
        self.curves = Curves(f"/{name}")
        self._name = name
        self._stream = stream
        self._say = say
        self._is_live = is_live
        self._world = Layer(f"/{name}/horizon/world", 1)
        self._words = Layer(f"/{name}/horizon/words", 3)
        self._figures = Layer(f"/{name}/horizon/figures", 4)
        self._bodies = Layer(f"/{name}/bodies")
        self._picture_due_us = self._point_due_us = 0
        self._pictures = 0  # of the horizon so far
        self._heard: dict[str, Heard] = {}  # by source, the latest last
        self._rate_rad_s: Vec3 = (0.0, 0.0, 0.0)
        self._status: StatusRecord | None = None
        self._before: StatusRecord | None = None
        self._field: ImuSample | None = None  # the latest with a field
        self._mean = bodies.FieldMean()
        self._state: State | None = None
        self._was_on_its_back = False
        self._level: Level | None = None  # told last
        self._told_us = 0
        self._introduce()

    def take_peer(self, peer: Peer) -> None:
        """Somebody else's attitude."""
        self._heard.pop(peer.source, None)
        self._heard[peer.source] = Heard(peer)

    def take_attitude(
        self, record: AttitudeRecord, sample: ImuSample | None, vehicles: int
    ) -> None:
        """Ours, with the sample that it comes from; one of so many vehicles."""
        now_us = record.time_unix_us
        for source, (peer, at_us) in self._heard.items():
            self._heard[source] = Heard(peer, now_us if at_us is None else at_us)
        self._rate_rad_s = record.rate_rad_s
        if sample is not None and sample.has_mag and sample is not self._field:
            field_ned = rotate(record.q_ned_frd, sample.mag_gauss)
            self._mean = bodies.observe_field(self._mean, field_ned, now_us)
            self._field = sample
        if _is_due(self._point_due_us, now_us, POINTS_HZ):
            self._add_points(record)
            if self.curves.is_full(vehicles):
                self.curves.flush(self._stream)
            self._point_due_us = now_us + round(1e6 / POINTS_HZ)
        picture_hz = min(PICTURES_HZ, ALL_PICTURES_HZ / vehicles)
        if _is_due(self._picture_due_us, now_us, picture_hz):
            self._draw(record, sample)
            self._picture_due_us = now_us + round(1e6 / picture_hz)

    def take_status(self, status: StatusRecord, now_us: int) -> None:
        """Keep it for the next picture; where there is no attitude it is the picture."""
        self._before, self._status = self._status, status
        if State(status.state) not in HAS_ATTITUDE:
            self._draw_horizon(State(status.state), None, now_us)

    def _introduce(self) -> None:
        """Shapes, names and colours, once."""
        name, static, still = self._name, self._stream.static, frame()
        panels = rr.LineStrips2D(
            [strip.points for strip in still],
            radii=[strip.radius for strip in still],
            colors=[strip.colour for strip in still],
            draw_order=2,
        )
        static(f"/{name}/horizon/frame", panels)
        static(f"/{name}", rr.ViewCoordinates.FRD)
        static(f"/{name}/bodies/compass", bodies.compass())
        static(f"/{name}/bodies/compass/names", bodies.compass_names())
        states = [state.value for state in STATE_COLOURS]
        colours = list(STATE_COLOURS.values())
        static(f"/{name}/state", rr.StateConfiguration(values=states, colors=colours))
        for curve, (names, line_colours) in layout.LINES.items():
            self._stream.lines(f"/{name}/{curve}", list(names), list(line_colours))

    def _peers(self, now_us: int) -> list[Peer]:
        """Attitudes by others that are fresh, turned by the vehicle's rate since they came."""
        fresh = []
        for peer, at_us in self._heard.values():
            age_us = now_us - (at_us or now_us)
            if abs(age_us) <= PEER_SILENT_US:
                turn = exp(scale(1e-6 * age_us, self._rate_rad_s))
                q_ned_frd = multiply(peer.q_ned_frd, turn)
                fresh.append(Peer(peer.vehicle, peer.source, q_ned_frd))
        return fresh

    def _turn_deg(self, record: AttitudeRecord, other: Quaternion) -> float:
        """How far somebody else's attitude is off; NaN live in a fast turn.

        Then the time between two messages is a larger angle than what they differ by.
        """
        if self._is_live and hypot(*record.rate_rad_s) > FAST_RAD_S:
            return nan
        return degrees(angle_between(record.q_ned_frd, other))

    def _draw(self, record: AttitudeRecord, sample: ImuSample | None) -> None:
        """A picture of a valid attitude: horizon, bodies, vectors."""
        now_us, state = record.time_unix_us, State(record.state)
        self._draw_horizon(state, record, now_us)
        if self._pictures % FIGURES_EVERY != 1:
            return
        level = trust(state, record, self._status).horizon
        lines = [*bodies.solid(record.q_ned_frd), bodies.nose_range(record, level)]
        for peer in self._peers(now_us):
            lines += bodies.outline(peer.q_ned_frd, bodies.SOURCES[peer.source])
        if sample is not None:
            lines += self._vectors(record, sample).lines()
        self._bodies.draw(self._stream, lines, now_us)

    def _draw_horizon(self, state: State, record: AttitudeRecord | None, now_us: int) -> None:
        """The instrument, and how state and trust have changed."""
        self._stream.at(layout.TIMELINE, timestamp=1e-6 * now_us)
        now = trust(state, record, self._status, self._before)
        peers = self._peers(now_us) if record is not None else ()
        off = tuple((p, self._turn_deg(record, p.q_ned_frd)) for p in peers if record is not None)
        note, differs = _note(self._status), _differs(self._status)
        self._draw_scene(Scene(self._name, state, record, now, off, note, differs), now_us)
        self._pictures += 1
        if state is not self._state:
            self._say(f"vehicle {self._name}: {state}")
            self._stream.log(f"/{self._name}/state", rr.StateChange(state=[state.value]))
        if now.overall is not self._level and now_us - self._told_us >= TOLD_EVERY_US:
            why = ", ".join(caveat.text for caveat in now.caveats)
            self._say(f"vehicle {self._name}: {WORDS[now.overall]}" + f" ({why})" * bool(why))
            self._level, self._told_us = now.overall, now_us
        self._state, self._was_on_its_back = state, is_on_its_back(record)

    def _draw_scene(self, scene: Scene, now_us: int) -> None:
        """The layers that are due."""
        parts, stream = layers(scene), self._stream
        is_news = (
            scene.state is not self._state
            or scene.trust.overall is not self._level
            or is_on_its_back(scene.attitude) != self._was_on_its_back
        )
        self._world.draw(stream, parts.world, now_us)
        if self._pictures % FIGURES_EVERY == 0 or is_news:
            self._figures.draw(stream, parts.figures, now_us)
        if self._pictures % WORDS_EVERY == 0 or is_news:
            self._words.draw(stream, parts.words, now_us)

    def _vectors(self, record: AttitudeRecord, sample: ImuSample) -> bodies.Vectors:
        """The sample's measured directions; without a field, with that of an earlier sample."""
        field = self._field
        if field is not None and 0 <= sample.time_us - field.time_us <= FIELD_SILENT_US:
            sample = sample._replace(mag_gauss=field.mag_gauss, has_mag=True)
        return bodies.vectors(record.q_ned_frd, sample, self.profile.reference, self._mean)

    def _add_points(self, record: AttitudeRecord) -> None:
        """The next point of every curve."""
        curves, sigma = self.curves, record.sigma_deg
        curves.begin(1e-6 * record.time_unix_us)
        peers = self._peers(record.time_unix_us)
        others: dict[str, Quaternion] = {peer.source: peer.q_ned_frd for peer in peers}
        known = [others.get(source) for source in PEERS]
        off = [nan if q is None else self._turn_deg(record, q) for q in known]
        curves.add("off", [sigma.inclination, sigma.heading, *off])
        angles = [UNKNOWN if q is None else euler_deg(q) for q in known]
        curves.add_angles([record.euler_deg, *angles])
        curves.add("error", [record.error])
        curves.add("gain", [record.gain])
        curves.add("confidence", [record.confidence.gravity, record.confidence.magnetic])
        curves.add("rate", [degrees(x) for x in record.rate_rad_s])
        curves.add("bias", [degrees(x) for x in record.gyro_bias_rad_s])


def _is_due(due_us: int, now_us: int, rate_hz: float) -> bool:
    """Whether the time has come, also after a clock that was set."""
    return not 0 < due_us - now_us <= round(1e6 / rate_hz)


def _differs(status: StatusRecord | None) -> bool:
    return status is not None and Alarm.AUTOPILOT_DIFFERS in status.warnings


def _note(status: StatusRecord | None) -> str:
    """The IMU's message and rate."""
    if status is None or status.imu_message is None:
        return ""
    digits = 0 if status.imu_rate_hz >= 10.0 else 1
    return f"{status.imu_message} {status.imu_rate_hz:.{digits}f} Hz"
