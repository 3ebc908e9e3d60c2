"""The Rerun viewer as a sink: attitudes in 3D, curves, the gain on its surface."""

from collections.abc import Sequence
from contextlib import suppress
from math import acos, degrees
from typing import TYPE_CHECKING, Any, NamedTuple

from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.types import Quaternion, Vec3
from fuzzbee import viewer_layout as layout
from fuzzbee.viewer_process import MISSING, ViewerProcess
from service.attitude_record import euler_deg
from service.records import AttitudeRecord, Message, Output, Peer, Published, vehicle_name

if TYPE_CHECKING:
    from estimator.memberships import Memberships

# Records drawn a second, of all vehicles together: the eye needs no more, and the
# interpreter is shared with the loop.
MAX_RECORDS_HZ = 60.0
MAX_VEHICLE_HZ = 20.0
PEER_SILENT_US = 2_000_000  # an older attitude of somebody else's is not drawn any more
CLOSE_FLUSH_S = 0.4  # less than the sinks have to close
SPACING_M = 1.8
OURS = "fuzzbee"
COLOURS = {OURS: layout.OURS, "autopilot": layout.AUTOPILOT, "sim": layout.TRUTH}


class ViewerOptions(NamedTuple):
    """What was asked for: a window or "web", or None; a file, or None."""

    view: str | None = None
    rrd: str | None = None


class Heard(NamedTuple):
    """The latest attitude by somebody else, and when it came."""

    source: str
    q_ned_frd: Quaternion
    at_us: int


class Seen(NamedTuple):
    """What is known of a vehicle between two drawings."""

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

    def __init__(self, options: ViewerOptions, k: "Memberships") -> None:
        rr = _rerun()
        self._recording: Any = rr.RecordingStream("fuzzbee", send_properties=False)
        self._recording.set_log_time_enabled(False)  # the records have a time of their own
        self._recording.set_log_tick_enabled(False)
        self.process: ViewerProcess | None = _start(options)
        sinks = []
        if self.process is not None:
            sinks.append(rr.GrpcSink(self.process.url))
        if options.rrd is not None:
            sinks.append(_file_sink(options.rrd))
        self._recording.set_sinks(*sinks, default_blueprint=layout.blueprint())
        self._vehicles: dict[VehicleId, Seen] = {}
        self._now_us = 0
        self._draw_surface(k)

    @property
    def page(self) -> str | None:
        """What a browser opens."""
        return None if self.process is None else self.process.page

    def handle(self, outputs: Sequence[Output]) -> None:
        """Draw the outputs that are due."""
        for output in outputs:
            match output:
                case Published(vehicle=vehicle, record=AttitudeRecord() as record):
                    self._on_attitude(vehicle, record)
                case Peer(vehicle=vehicle, source=source, q_ned_frd=q):
                    self._on_peer(vehicle, source, q)
                case Message(text=text):
                    self._say(text)

    def close(self) -> None:
        """Send what is pending, and end the viewer."""
        with suppress(Exception):  # the window may be closed already
            self._recording.flush(timeout_sec=CLOSE_FLUSH_S)
        self._recording.disconnect()
        if self.process is not None:
            self.process.close()
            self.process = None

    def finish(self) -> None:
        """Send what is pending and leave the viewer open."""
        self._recording.flush(timeout_sec=60.0)

    def _on_peer(self, vehicle: VehicleId, source: str, q: Quaternion) -> None:
        seen = self._vehicles.get(vehicle)
        if seen is not None:
            others = tuple(peer for peer in seen.peers if peer.source != source)
            heard = Heard(source, q, self._now_us)
            self._vehicles[vehicle] = seen._replace(peers=(*others, heard))

    def _on_attitude(self, vehicle: VehicleId, record: AttitudeRecord) -> None:
        if vehicle not in self._vehicles:
            self._vehicles[vehicle] = Seen(len(self._vehicles))
            self._introduce(vehicle_name(vehicle), len(self._vehicles) - 1)
        seen = self._vehicles[vehicle]
        now_us = self._now_us = record.time_unix_us
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
        self._recording.set_time(layout.TIMELINE, timestamp=1e-6 * now_us)
        if record.state != seen.state:
            self._say(f"vehicle {name}: {record.state}")
        self._draw(name, seen, record)

    def _draw(self, name: str, seen: Seen, record: AttitudeRecord) -> None:
        self._draw_attitude(name, seen.row, OURS, record.q_ned_frd, record.euler_deg)
        for source, q, at_us in seen.peers:
            if abs(record.time_unix_us - at_us) > PEER_SILENT_US:
                continue
            self._draw_attitude(name, seen.row, source, q, euler_deg(q))
            self._curve(f"/off/{name}/{source}", [_angle_deg(record.q_ned_frd, q)])
        self._curve(f"/error/{name}", [record.error])
        self._curve(f"/gain/{name}", [record.gain])
        self._curve(f"/confidence/{name}", [record.confidence.gravity, record.confidence.magnetic])
        self._curve(f"/off/{name}/sigma", [record.sigma_deg.inclination, record.sigma_deg.heading])
        self._curve(f"/rate/{name}", [degrees(x) for x in record.rate_rad_s])
        self._curve(f"/bias/{name}", [degrees(x) for x in record.gyro_bias_rad_s])
        at = (record.error, min(abs(record.error_rate), 1.0), (record.gain - 1.0) / 100.0)
        self._log(
            f"/surface/{name}", _rerun().Points3D([at], radii=0.03, labels=[f"vehicle {name}"])
        )

    def _draw_attitude(
        self, name: str, row: int, source: str, q_ned_frd: Quaternion, angles_deg: Vec3
    ) -> None:
        rr = _rerun()
        w, x, y, z = q_ned_frd
        column = list(COLOURS).index(source)
        place = (-SPACING_M * row, SPACING_M * column, 0.0)
        turn = rr.Quaternion(xyzw=(x, y, z, w))
        self._log(f"/attitude/{name}/{source}", rr.Transform3D(translation=place, quaternion=turn))
        self._curve(f"/angles/{name}/{source}", angles_deg)

    def _introduce(self, name: str, row: int) -> None:
        """Shapes, names and colours of a vehicle, once."""
        rr = _rerun()
        if row == 0:
            self._static("/attitude/world", layout.world_axes())
        self._lines(f"/error/{name}", [name], [layout.OURS])
        self._lines(f"/gain/{name}", [name], [layout.AUTOPILOT])
        pair = [layout.OURS, layout.AUTOPILOT]
        self._lines(f"/confidence/{name}", [f"{name} gravity", f"{name} magnetic"], pair)
        sigmas = [f"{name} inclination sigma", f"{name} heading sigma"]
        self._lines(f"/off/{name}/sigma", sigmas, list(layout.SIGMAS))
        for quantity in ("rate", "bias"):
            names = [f"{name} {axis}" for axis in ("x", "y", "z")]
            self._lines(f"/{quantity}/{name}", names, list(layout.AXES))
        self._static("/attitude", rr.ViewCoordinates.FRD)

    def _introduce_source(self, name: str, source: str) -> None:
        """Shape, names and colours of one estimate of a vehicle's attitude."""
        path = f"/attitude/{name}/{source}"
        self._static(f"{path}/body", layout.vehicle_shape(COLOURS[source]))
        self._static(f"{path}/axes", layout.body_axes())
        fade = 255 if source == OURS else 150
        self._lines(
            f"/angles/{name}/{source}",
            [f"{name} {source} {angle}" for angle in ("roll", "pitch", "heading")],
            [(*axis, fade) for axis in layout.AXES],
        )
        if source != OURS:
            self._lines(f"/off/{name}/{source}", [f"{name} to {source}"], [COLOURS[source]])

    def _draw_surface(self, k: "Memberships") -> None:
        from estimator.fuzzy import fuzzy_gain

        self._static("/surface", _rerun().ViewCoordinates.RIGHT_HAND_Z_UP)
        self._static("/surface/gain", layout.gain_surface(k, fuzzy_gain))
        self._static("/surface/axes", layout.surface_axes())

    def _say(self, text: str) -> None:
        if self._now_us:  # before the first attitude there is no time
            self._recording.set_time(layout.TIMELINE, timestamp=1e-6 * self._now_us)
            self._log("/state", _rerun().TextLog(text))

    def _lines(self, path: str, names: list[str], colours: list[Any]) -> None:
        self._static(path, _rerun().SeriesLines(names=names, colors=colours))

    def _curve(self, path: str, values: Sequence[float]) -> None:
        self._log(path, _rerun().Scalars(list(values)))

    def _static(self, path: str, shape: Any) -> None:
        self._recording.log(path, shape, static=True)

    def _log(self, path: str, shape: Any) -> None:
        self._recording.log(path, shape)


def _rerun() -> Any:
    try:
        import rerun
    except ImportError:
        raise InputError(MISSING) from None
    return rerun


def _start(options: ViewerOptions) -> ViewerProcess | None:
    return None if options.view is None else ViewerProcess(web=options.view == "web")


def _file_sink(path: str) -> Any:
    try:
        with open(path, "wb"):  # noqa: PTH123 - Rerun would only log an error
            pass
    except OSError as error:
        raise InputError(f"--rrd {path}: {error.strerror}") from error
    return _rerun().FileSink(path)


def _angle_deg(q: Quaternion, r: Quaternion) -> float:
    """Of the turn between two attitudes."""
    w = abs(sum(a * b for a, b in zip(q, r, strict=True)))
    return degrees(2.0 * acos(min(1.0, w)))
