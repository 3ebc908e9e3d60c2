"""The Rerun viewer as a sink: horizons, bodies in one place, curves, the gain on its surface.

What the eye needs is sent, and no more: a browser that draws in software takes in a few hundred
pieces a second, and what it cannot take in at once it shows late. So the horizon is one piece,
curves go in batches, and what stands still is sent once.
"""

from collections.abc import Sequence
from math import acos, degrees, hypot, nan
from typing import TYPE_CHECKING, Literal, NamedTuple

from drivers.events import VehicleId
from estimator.geometry.quaternion import exp, multiply, rotate
from estimator.types import ImuSample, Quaternion, Vec3
from fuzzbee.trust import WORDS, Level, trust
from fuzzbee.viewer import bodies, layout
from fuzzbee.viewer.curves import Curves
from fuzzbee.viewer.gain_surface import gain_shape, gain_surface, surface_axes
from fuzzbee.viewer.horizon import COLOURS, Scene, frame, is_on_its_back, layers
from fuzzbee.viewer.layer import Layer
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream, rerun
from service.attitude_record import euler_deg
from service.health import HAS_ATTITUDE, State
from service.records import (
    AttitudeRecord,
    Departed,
    Message,
    Output,
    Peer,
    Published,
    Replaced,
    StatusRecord,
    vehicle_name,
)

if TYPE_CHECKING:
    from estimator.profile import Profile
    from fuzzbee.viewer.gain_surface import GainShape

# Pictures a second: of one vehicle, and of all together.
PICTURES_HZ = 4.0
ALL_PICTURES_HZ = 6.0
FIGURES_EVERY = 2  # pictures: digits that change more often cannot be read; the bodies with them
WORDS_EVERY = 4  # pictures; at once if the state or the trust has changed
POINTS_HZ = 10.0  # of a curve; they go in batches
PEER_SILENT_US = 2_000_000  # an older attitude of somebody else's is not drawn any more
FAST_RAD_S = 0.9  # 50 deg/s: a degree in the 20 ms that two messages are apart
PAGES_WAIT_US = 1_000_000  # a fleet appears within so long
FIELD_SILENT_US = 1_000_000
TOLD_EVERY_US = 1_000_000  # how trust changes is told once a second at most
PEERS: tuple[Literal["autopilot"], Literal["sim"]] = ("autopilot", "sim")
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


class Seen(NamedTuple):
    """What is kept of a vehicle from one drawing to the next."""

    picture_due_us: int = 0
    point_due_us: int = 0
    state: State | None = None
    heard: tuple[Heard, ...] = ()
    rate_rad_s: Vec3 = (0.0, 0.0, 0.0)
    status: StatusRecord | None = None
    before: StatusRecord | None = None
    field: ImuSample | None = None  # the latest with a field
    mean: bodies.FieldMean = bodies.FieldMean()
    pictures: int = 0  # of the horizon so far
    is_on_its_back: bool = False
    level: Level | None = None  # told last
    told_us: int = 0

    def peers(self, now_us: int) -> tuple[Peer, ...]:
        """Those that are fresh, turned by the vehicle's rate since they came."""
        fresh = [h for h in self.heard if abs(now_us - (h.at_us or now_us)) <= PEER_SILENT_US]
        return tuple(_turned(h, self.rate_rad_s, now_us) for h in fresh)


class VehicleLayers:
    """What moves on a vehicle's page."""

    def __init__(self, name: str) -> None:
        self.world = Layer(f"/{name}/horizon/world", 1)
        self.words = Layer(f"/{name}/horizon/words", 3)
        self.figures = Layer(f"/{name}/horizon/figures", 4)
        self.bodies = Layer(f"/{name}/bodies")


class ViewerSink:
    """Draws what the service publishes with ``profile``.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    name = "viewer"

    def __init__(self, options: ViewerOptions, profile: "Profile") -> None:
        self.stream = ViewerStream(options, layout.blueprint)
        self._vehicles: dict[VehicleId, Seen] = {}
        self._curves: dict[VehicleId, Curves] = {}
        self._layers: dict[VehicleId, VehicleLayers] = {}
        self._has_left_out = False
        self._shared = profile  # for vehicles without parameters of their own
        self._own: dict[VehicleId, Profile] = {}
        shape = gain_shape(profile)
        # the surfaces shown; the first is made here, since making it compiles a kernel
        self._surfaces: dict[GainShape, object] = {shape: gain_surface(shape)}
        self._drawn = 0  # number of surfaces in the viewer
        self._now_us = 0
        self._pages_due_us: int | None = None  # vehicles wait for pages of their own
        self._is_live = options.live
        self.stream.static("/surface", rerun().ViewCoordinates.RIGHT_HAND_Z_UP)
        self.stream.static("/surface/axes", surface_axes())

    def handle(self, outputs: Sequence[Output]) -> None:
        """Draw the outputs that are due.

        Raises:
            ConnectionError: once, if the viewer has been closed.
        """
        if self.stream.take_loss():
            raise ConnectionError(CLOSED)
        if not self.stream.is_wanted:
            return
        for output in outputs:
            match output:
                case Published(vehicle=vehicle, record=AttitudeRecord() as record):
                    self._on_attitude(vehicle, record, output.sample)
                case Published(vehicle=vehicle, record=StatusRecord() as status):
                    self._on_status(vehicle, status, output.time_unix_us)
                case Peer(vehicle=vehicle):
                    self._on_peer(vehicle, output)
                case Replaced(vehicle=vehicle, profile=profile):
                    self._on_replaced(vehicle, profile)
                case Departed(vehicle=vehicle):
                    self._on_departed(vehicle)
                case Message(text=text):
                    self._say(text)

    def finish(self) -> None:
        """Send what is pending and leave the viewer open."""
        self._flush()
        self.stream.finish()

    def close(self) -> None:
        """Send what is pending, and end the viewer."""
        self._flush()
        self.stream.close()

    def _on_peer(self, vehicle: VehicleId, peer: Peer) -> None:
        seen = self._vehicles.get(vehicle)
        if seen is not None:
            others = tuple(h for h in seen.heard if h.peer.source != peer.source)
            heard = (*others, Heard(peer))
            self._vehicles[vehicle] = seen._replace(heard=heard)

    def _on_attitude(
        self, vehicle: VehicleId, record: AttitudeRecord, sample: ImuSample | None
    ) -> None:
        now_us = self._now_us = record.time_unix_us
        if not self._is_met(vehicle):
            return
        self._show_pages_if_due()
        seen = self._vehicles[vehicle]
        heard = tuple(Heard(h.peer, now_us if h.at_us is None else h.at_us) for h in seen.heard)
        seen = seen._replace(heard=heard, rate_rad_s=record.rate_rad_s)
        if sample is not None and sample.has_mag and sample is not seen.field:
            field_ned = rotate(record.q_ned_frd, sample.mag_gauss)
            mean = bodies.observe_field(seen.mean, field_ned, now_us)
            seen = seen._replace(field=sample, mean=mean)
        if _is_due(seen.point_due_us, now_us, POINTS_HZ):
            self._add_points(vehicle, seen, record)
            seen = seen._replace(point_due_us=now_us + round(1e6 / POINTS_HZ))
        picture_hz = min(PICTURES_HZ, ALL_PICTURES_HZ / len(self._vehicles))
        if _is_due(seen.picture_due_us, now_us, picture_hz):
            seen = self._draw(vehicle, seen, record, sample)
            seen = seen._replace(picture_due_us=now_us + round(1e6 / picture_hz))
        self._vehicles[vehicle] = seen

    def _on_status(self, vehicle: VehicleId, status: StatusRecord, now_us: int) -> None:
        """Keep it for the next picture; where there is no attitude it is the picture."""
        self._now_us = now_us or self._now_us
        if not self._now_us or not self._is_met(vehicle):
            return
        self._show_pages_if_due()
        seen = self._vehicles[vehicle]
        seen = seen._replace(status=status, before=seen.status)
        if State(status.state) not in HAS_ATTITUDE:
            seen = self._draw_horizon(vehicle, seen, State(status.state), None)
        self._vehicles[vehicle] = seen

    def _is_met(self, vehicle: VehicleId) -> bool:
        """Whether the vehicle has a page; a new one gets it as long as there is room."""
        if vehicle in self._vehicles:
            return True
        if len(self._vehicles) >= layout.MOST_VEHICLES:
            self._leave_out()
            return False
        self._vehicles[vehicle] = Seen()
        self._curves[vehicle] = Curves(f"/{vehicle_name(vehicle)}")
        self._layers[vehicle] = VehicleLayers(vehicle_name(vehicle))
        self._introduce(vehicle_name(vehicle))
        if len(self._vehicles) == 1:
            self._show_pages()
        else:  # more may follow: a page for each takes a browser a while to take in
            self._pages_due_us = self._now_us + PAGES_WAIT_US
        self._at_now()
        self._draw_surfaces()
        return True

    def _show_pages(self) -> None:
        """Arrange a page for each vehicle."""
        self._pages_due_us = None
        self.stream.show(layout.blueprint([vehicle_name(v) for v in self._vehicles]))

    def _show_pages_if_due(self) -> None:
        due_us = self._pages_due_us
        if due_us is not None and not 0 < due_us - self._now_us <= PAGES_WAIT_US:
            self._show_pages()

    def _leave_out(self) -> None:
        if not self._has_left_out:
            self._say(f"only the first {layout.MOST_VEHICLES} vehicles are drawn")
        self._has_left_out = True

    def _on_departed(self, vehicle: VehicleId) -> None:
        """Give its page to the next one; what was drawn of it stays in the recording."""
        self._own.pop(vehicle, None)
        if self._vehicles.pop(vehicle, None) is None:
            return
        self._curves.pop(vehicle).flush(self.stream)
        del self._layers[vehicle]
        self._pages_due_us = self._now_us + PAGES_WAIT_US

    def _draw(
        self, vehicle: VehicleId, seen: Seen, record: AttitudeRecord, sample: ImuSample | None
    ) -> Seen:
        """A picture of a valid attitude: horizon, bodies, vectors, the place on the surface."""
        seen = self._draw_horizon(vehicle, seen, State(record.state), record)
        if seen.pictures % FIGURES_EVERY != 1:
            return seen
        level = trust(State(record.state), record, seen.status).horizon
        lines = [*bodies.solid(record.q_ned_frd), bodies.nose_range(record, level)]
        for peer in seen.peers(record.time_unix_us):
            lines += bodies.outline(peer.q_ned_frd, bodies.SOURCES[peer.source])
        if sample is not None:
            lines += self._vectors(vehicle, seen, record, sample).lines()
        self._layers[vehicle].bodies.draw(self.stream, lines, record.time_unix_us)
        if not isinstance(gain_shape(self._own.get(vehicle, self._shared)), float):
            self._draw_place(vehicle_name(vehicle), record)
        return seen

    def _draw_place(self, name: str, record: AttitudeRecord) -> None:
        """Where the vehicle stands on the gain's surface."""
        at = (record.error, min(abs(record.error_rate), 1.0), (record.gain - 1.0) / 100.0)
        self.stream.log(
            f"/surface/{name}", rerun().Points3D([at], radii=0.03, labels=[f"vehicle {name}"])
        )

    def _draw_horizon(
        self, vehicle: VehicleId, seen: Seen, state: State, record: AttitudeRecord | None
    ) -> Seen:
        """The instrument, and how state and trust have changed."""
        name, now_us = vehicle_name(vehicle), self._now_us
        self._at_now()
        now = trust(state, record, seen.status, seen.before)
        peers = () if record is None else self._with_turns(record, seen.peers(now_us))
        scene = Scene(name, state, record, now, peers, _note(seen.status))
        self._draw_scene(vehicle, seen, scene)
        seen = seen._replace(pictures=seen.pictures + 1)
        if state is not seen.state:
            self._say(f"vehicle {name}: {state}")
            self.stream.log(f"/{name}/state", rerun().StateChange(state=[state.value]))
        if now.overall is not seen.level and now_us - seen.told_us >= TOLD_EVERY_US:
            why = ", ".join(doubt.text for doubt in now.doubts)
            self._say(f"vehicle {name}: {WORDS[now.overall]}" + f" ({why})" * bool(why))
            seen = seen._replace(level=now.overall, told_us=now_us)
        return seen._replace(state=state, is_on_its_back=is_on_its_back(record))

    def _draw_scene(self, vehicle: VehicleId, seen: Seen, scene: Scene) -> None:
        """The layers that are due."""
        parts, drawn, now_us = layers(scene), self._layers[vehicle], self._now_us
        is_news = (
            scene.state is not seen.state
            or scene.trust.overall is not seen.level
            or is_on_its_back(scene.attitude) != seen.is_on_its_back
        )
        drawn.world.draw(self.stream, parts.world, now_us)
        if seen.pictures % FIGURES_EVERY == 0 or is_news:
            drawn.figures.draw(self.stream, parts.figures, now_us)
        if seen.pictures % WORDS_EVERY == 0 or is_news:
            drawn.words.draw(self.stream, parts.words, now_us)

    def _with_turns(
        self, record: AttitudeRecord, peers: tuple[Peer, ...]
    ) -> tuple[tuple[Peer, float], ...]:
        return tuple((peer, self._turn_deg(record, peer.q_ned_frd)) for peer in peers)

    def _turn_deg(self, record: AttitudeRecord, other: Quaternion) -> float:
        """How far somebody else's attitude is off; NaN live in a fast turn.

        Then the time between two messages is a larger angle than what they differ by.
        """
        if self._is_live and hypot(*record.rate_rad_s) > FAST_RAD_S:
            return nan
        return _angle_deg(record.q_ned_frd, other)

    def _vectors(
        self, vehicle: VehicleId, seen: Seen, record: AttitudeRecord, sample: ImuSample
    ) -> bodies.Vectors:
        """Of the sample, with the field of an earlier one if it has none of its own."""
        field = seen.field
        if field is not None and 0 <= sample.time_us - field.time_us <= FIELD_SILENT_US:
            sample = sample._replace(mag_gauss=field.mag_gauss, has_mag=True)
        reference = self._own.get(vehicle, self._shared).reference
        return bodies.vectors(record.q_ned_frd, sample, reference, seen.mean)

    def _add_points(self, vehicle: VehicleId, seen: Seen, record: AttitudeRecord) -> None:
        """The next point of every curve."""
        curves = self._curves[vehicle]
        curves.begin(1e-6 * record.time_unix_us)
        sigma = record.sigma_deg
        others = {peer.source: peer.q_ned_frd for peer in seen.peers(record.time_unix_us)}
        off = [self._turn_deg(record, others[s]) if s in others else nan for s in PEERS]
        curves.add("off", [sigma.inclination, sigma.heading, *off])
        angles = [euler_deg(others[s]) if s in others else UNKNOWN for s in PEERS]
        curves.add_angles([record.euler_deg, *angles])
        curves.add("error", [record.error])
        curves.add("gain", [record.gain])
        curves.add("confidence", [record.confidence.gravity, record.confidence.magnetic])
        curves.add("rate", [degrees(x) for x in record.rate_rad_s])
        curves.add("bias", [degrees(x) for x in record.gyro_bias_rad_s])
        if curves.is_full(len(self._vehicles)):
            curves.flush(self.stream)

    def _flush(self) -> None:
        """Send what waits: curves, and pages of the latest vehicles."""
        for curves in self._curves.values():
            curves.flush(self.stream)
        if self._pages_due_us is not None:
            self._show_pages()

    def _introduce(self, name: str) -> None:
        """Shapes, names and colours of a vehicle, once."""
        rr = rerun()
        still = frame()
        self.stream.static(
            f"/{name}/horizon/frame",
            rr.LineStrips2D(
                [strip.points for strip in still],
                radii=[strip.radius for strip in still],
                colors=[strip.colour for strip in still],
                draw_order=2,
            ),
        )
        self.stream.static(f"/{name}", rr.ViewCoordinates.FRD)
        self.stream.static(f"/{name}/bodies/compass", bodies.compass())
        self.stream.static(f"/{name}/bodies/compass/names", bodies.compass_names())
        self.stream.static(
            f"/{name}/state",
            rr.StateConfiguration(
                values=[state.value for state in STATE_COLOURS],
                colors=list(STATE_COLOURS.values()),
            ),
        )
        for curve, (names, colours) in layout.LINES.items():
            self.stream.lines(f"/{name}/{curve}", list(names), list(colours))

    def _on_replaced(self, vehicle: VehicleId, profile: "Profile") -> None:
        self._own[vehicle] = profile
        self._at_now()
        self._draw_surfaces()

    def _draw_surfaces(self) -> None:
        """One for each shape of the gain in use, from now on."""
        used = dict.fromkeys(
            gain_shape(self._own.get(vehicle, self._shared)) for vehicle in self._vehicles
        )
        if not used or (self._drawn and used.keys() == self._surfaces.keys()):
            return
        known = self._surfaces
        self._surfaces = {k: known[k] if k in known else gain_surface(k) for k in used}
        for number, shape in enumerate(self._surfaces.values()):
            self.stream.log(f"/surface/gain/{number}", shape)
        for number in range(len(used), self._drawn):
            self.stream.log(f"/surface/gain/{number}", rerun().Clear(recursive=False))
        self._drawn = len(used)

    def _say(self, text: str) -> None:
        if self._now_us:  # before the first record there is no time
            self._at_now()
            self.stream.log("/messages", rerun().TextLog(text))

    def _at_now(self) -> None:
        self.stream.at(layout.TIMELINE, timestamp=1e-6 * self._now_us)


def _is_due(due_us: int, now_us: int, rate_hz: float) -> bool:
    """Whether the time has come, also after a clock that was set."""
    return not 0 < due_us - now_us <= round(1e6 / rate_hz)


def _note(status: StatusRecord | None) -> str:
    if status is None or status.imu_message is None:
        return ""
    return (
        f"{status.imu_message} {status.imu_rate_hz:.0f} Hz"
        if status.imu_rate_hz >= 10.0
        else (f"{status.imu_message} {status.imu_rate_hz:.1f} Hz")
    )


def _turned(heard: Heard, rate_rad_s: Vec3, now_us: int) -> Peer:
    """Somebody else's attitude as it has become since it came."""
    age_s = 1e-6 * (now_us - (heard.at_us or now_us))
    turn = exp((age_s * rate_rad_s[0], age_s * rate_rad_s[1], age_s * rate_rad_s[2]))
    peer = heard.peer
    return Peer(peer.vehicle, peer.source, multiply(peer.q_ned_frd, turn))


def _angle_deg(q: Quaternion, r: Quaternion) -> float:
    """Angle of the turn between two attitudes, in degrees."""
    w = abs(sum(a * b for a, b in zip(q, r, strict=True)))
    return degrees(2.0 * acos(min(1.0, w)))
