"""The Rerun viewer as a sink: attitudes in 3D, curves, the gain on its surface."""

from collections.abc import Sequence
from math import acos, degrees
from typing import TYPE_CHECKING, NamedTuple

from drivers.events import VehicleId
from estimator.types import Quaternion, Vec3
from fuzzbee.viewer import layout
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream, rerun
from service.attitude_record import euler_deg
from service.records import (
    AttitudeRecord,
    Message,
    Output,
    Peer,
    Published,
    Replaced,
    vehicle_name,
)

if TYPE_CHECKING:
    from fuzzbee.viewer.layout import GainShape

# Records drawn a second, of all vehicles together: the eye needs no more, and the
# interpreter is shared with the loop.
MAX_RECORDS_HZ = 60.0
MAX_VEHICLE_HZ = 20.0
PEER_SILENT_US = 2_000_000  # an older attitude of somebody else's is not drawn any more
SPACING_M = 1.8
OURS = "fuzzbee"
COLOURS = {OURS: layout.OURS, "autopilot": layout.AUTOPILOT, "sim": layout.TRUTH}


class Heard(NamedTuple):
    """The latest attitude by somebody else, and when it came."""

    source: str
    q_ned_frd: Quaternion
    at_us: int


class Seen(NamedTuple):
    """What is kept of a vehicle from one drawing to the next."""

    row: int
    due_us: int = 0
    state: str = ""
    peers: tuple["Heard", ...] = ()
    shown: frozenset[str] = frozenset()  # whose shapes are there


class ViewerSink:
    """Draws what the service publishes.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    name = "viewer"

    def __init__(self, options: ViewerOptions, shape: "GainShape") -> None:
        self.stream = ViewerStream(options, layout.blueprint)
        self._vehicles: dict[VehicleId, Seen] = {}
        self._shared = shape  # for vehicles without parameters of their own
        self._own: dict[VehicleId, GainShape] = {}
        # the surfaces shown; the first is made here, since making it compiles a kernel
        self._surfaces = {shape: layout.gain_surface(shape)}
        self._drawn = 0  # number of surfaces in the viewer
        self._now_us = 0
        self.stream.static("/surface", rerun().ViewCoordinates.RIGHT_HAND_Z_UP)
        self.stream.static("/surface/axes", layout.surface_axes())

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
                    self._on_attitude(vehicle, record)
                case Peer(vehicle=vehicle, source=source, q_ned_frd=q):
                    self._on_peer(vehicle, source, q)
                case Replaced(vehicle=vehicle, profile=profile):
                    self._on_replaced(vehicle, layout.gain_shape(profile))
                case Message(text=text):
                    self._say(text)

    def close(self) -> None:
        """Send what is pending, and end the viewer."""
        self.stream.close()

    def _on_peer(self, vehicle: VehicleId, source: str, q: Quaternion) -> None:
        seen = self._vehicles.get(vehicle)
        if seen is not None:
            others = tuple(peer for peer in seen.peers if peer.source != source)
            heard = Heard(source, q, self._now_us)
            self._vehicles[vehicle] = seen._replace(peers=(*others, heard))

    def _on_attitude(self, vehicle: VehicleId, record: AttitudeRecord) -> None:
        now_us = self._now_us = record.time_unix_us
        if vehicle not in self._vehicles:
            self._vehicles[vehicle] = Seen(len(self._vehicles))
            self._introduce(vehicle_name(vehicle), len(self._vehicles) - 1)
            self.stream.at(layout.TIMELINE, timestamp=1e-6 * now_us)
            self._draw_surfaces()
        seen = self._vehicles[vehicle]
        period_us = round(1e6 / min(MAX_VEHICLE_HZ, MAX_RECORDS_HZ / len(self._vehicles)))
        if 0 < seen.due_us - now_us <= period_us:
            return
        name = vehicle_name(vehicle)
        sources = {OURS, *(peer.source for peer in seen.peers)}
        for source in sources - seen.shown:
            self._introduce_source(name, source)
        self._vehicles[vehicle] = seen._replace(
            due_us=now_us + period_us, state=record.state, shown=seen.shown | sources
        )
        self.stream.at(layout.TIMELINE, timestamp=1e-6 * now_us)
        if record.state != seen.state:
            self._say(f"vehicle {name}: {record.state}")
        self._draw(name, seen, record)

    def _draw(self, name: str, seen: Seen, record: AttitudeRecord) -> None:
        self._draw_attitude(name, seen.row, OURS, record.q_ned_frd, record.euler_deg)
        for source, q, at_us in seen.peers:
            if abs(record.time_unix_us - at_us) > PEER_SILENT_US:
                continue
            self._draw_attitude(name, seen.row, source, q, euler_deg(q))
            self.stream.curve(f"/off/{name}/{source}", [_angle_deg(record.q_ned_frd, q)])
        self.stream.curve(f"/error/{name}", [record.error])
        self.stream.curve(f"/gain/{name}", [record.gain])
        self.stream.curve(
            f"/confidence/{name}", [record.confidence.gravity, record.confidence.magnetic]
        )
        self.stream.curve(
            f"/off/{name}/sigma", [record.sigma_deg.inclination, record.sigma_deg.heading]
        )
        self.stream.curve(f"/rate/{name}", [degrees(x) for x in record.rate_rad_s])
        self.stream.curve(f"/bias/{name}", [degrees(x) for x in record.gyro_bias_rad_s])
        at = (record.error, min(abs(record.error_rate), 1.0), (record.gain - 1.0) / 100.0)
        self.stream.log(
            f"/surface/{name}", rerun().Points3D([at], radii=0.03, labels=[f"vehicle {name}"])
        )

    def _draw_attitude(
        self, name: str, row: int, source: str, q_ned_frd: Quaternion, angles_deg: Vec3
    ) -> None:
        rr = rerun()
        w, x, y, z = q_ned_frd
        column = list(COLOURS).index(source)
        place = (-SPACING_M * row, SPACING_M * column, 0.0)
        turn = rr.Quaternion(xyzw=(x, y, z, w))
        self.stream.log(
            f"/attitude/{name}/{source}", rr.Transform3D(translation=place, quaternion=turn)
        )
        self.stream.curve(f"/angles/{name}/{source}", angles_deg)

    def _introduce(self, name: str, row: int) -> None:
        """Shapes, names and colours of a vehicle, once."""
        rr = rerun()
        if row == 0:
            self.stream.static("/attitude/world", layout.world_axes())
        self.stream.lines(f"/error/{name}", [name], [layout.OURS])
        self.stream.lines(f"/gain/{name}", [name], [layout.AUTOPILOT])
        pair = [layout.OURS, layout.AUTOPILOT]
        self.stream.lines(f"/confidence/{name}", [f"{name} gravity", f"{name} magnetic"], pair)
        sigmas = [f"{name} inclination sigma", f"{name} heading sigma"]
        self.stream.lines(f"/off/{name}/sigma", sigmas, list(layout.SIGMAS))
        for quantity in ("rate", "bias"):
            names = [f"{name} {axis}" for axis in ("x", "y", "z")]
            self.stream.lines(f"/{quantity}/{name}", names, list(layout.AXES))
        self.stream.static("/attitude", rr.ViewCoordinates.FRD)

    def _introduce_source(self, name: str, source: str) -> None:
        """Shape, names and colours of one estimate of a vehicle's attitude."""
        path = f"/attitude/{name}/{source}"
        self.stream.static(f"{path}/body", layout.vehicle_shape(COLOURS[source]))
        self.stream.static(f"{path}/axes", layout.body_axes())
        fade = 255 if source == OURS else 150
        self.stream.lines(
            f"/angles/{name}/{source}",
            [f"{name} {source} {angle}" for angle in ("roll", "pitch", "heading")],
            [(*axis, fade) for axis in layout.AXES],
        )
        if source != OURS:
            self.stream.lines(f"/off/{name}/{source}", [f"{name} to {source}"], [COLOURS[source]])

    def _on_replaced(self, vehicle: VehicleId, shape: "GainShape") -> None:
        self._own[vehicle] = shape
        self._draw_surfaces()

    def _draw_surfaces(self) -> None:
        """One for each shape of the gain in use, from now on."""
        used = dict.fromkeys(self._own.get(vehicle, self._shared) for vehicle in self._vehicles)
        if not used or (self._drawn and used.keys() == self._surfaces.keys()):
            return
        known = self._surfaces
        self._surfaces = {k: known[k] if k in known else layout.gain_surface(k) for k in used}
        for number, shape in enumerate(self._surfaces.values()):
            self.stream.log(f"/surface/gain/{number}", shape)
        for number in range(len(used), self._drawn):
            self.stream.log(f"/surface/gain/{number}", rerun().Clear(recursive=False))
        self._drawn = len(used)

    def _say(self, text: str) -> None:
        if self._now_us:  # before the first attitude there is no time
            self.stream.at(layout.TIMELINE, timestamp=1e-6 * self._now_us)
            self.stream.log("/state", rerun().TextLog(text))


def _angle_deg(q: Quaternion, r: Quaternion) -> float:
    """Angle of the turn between two attitudes, in degrees."""
    w = abs(sum(a * b for a, b in zip(q, r, strict=True)))
    return degrees(2.0 * acos(min(1.0, w)))
