"""The Rerun viewer as a sink: bodies in one place, curves, states and messages."""

from collections.abc import Sequence
from math import degrees, hypot, nan

from drivers.events import VehicleId
from estimator.geometry.quaternion import angle_between, norm, rotate, scale
from estimator.types import STANDARD_GRAVITY_M_S2, Quaternion
from fuzzbee.verdict import Level, verdict_of
from fuzzbee.viewer import layout
from fuzzbee.viewer.stream import CLOSED, TIMELINE, ViewerStream, rr
from service import records
from service.publishing import euler_deg
from service.records import AttitudeRecord, State, StatusRecord

MOST_VEHICLES = 9  # drawn side by side; more cannot be read
FLUSH_US = 60_000_000  # between two batches of points into a file
POINT_US = 100_000  # between two points of a curve
FAST_RAD_S = 0.9  # 50 deg/s: a degree in the 20 ms that two messages are apart
VERDICT_EVERY_US = 1_000_000  # a change of the verdict is logged once a second at most
APART_M = 2.2  # between two vehicles, towards the east
SOURCES = {"ours": layout.OURS, "autopilot": layout.AUTOPILOT, "sim": layout.TRUTH}
VECTORS = {"gravity": layout.GRAVITY, "field": layout.FIELD}
ANGLES = ("tilt", "heading")  # plots of angles that wrap round
_BODY = [(0.8, 0.0, 0.0), (0.0, 0.45, 0.0), (0.0, 0.0, 0.25)]  # forward, right, down


class ViewerSink(ViewerStream):
    """Draws what the service publishes."""

    name = "viewer"

    def __init__(
        self, view: str | None = None, rrd: str | None = None, *, live: bool = False
    ) -> None:
        super().__init__(layout.blueprint(), view, rrd, live=live)
        self._tracks: dict[VehicleId, Track] = {}
        self._has_left_out = False
        self._now_us = self._flushed_us = 0

    def handle(self, outputs: Sequence[records.Output]) -> None:
        """Draw the outputs of one turn; raises once if the viewer was closed, or the file fails."""
        self.require_whole()
        if self.take_loss():
            raise ConnectionError(CLOSED)
        if not self.is_wanted:
            return
        for output in outputs:
            match output:
                case records.Published():
                    self._take_published(output)
                case records.Evicted(vehicle=vehicle) if vehicle in self._tracks:
                    del self._tracks[vehicle]
                # before the first record there is no time
                case records.Message(text=text) if self._now_us:
                    self.message(text, self._now_us)
        if not 0 <= self._now_us - self._flushed_us < FLUSH_US:
            self._flushed_us = self._now_us
            self.flush()

    def _take_published(self, output: records.Published) -> None:
        """A new vehicle gets a track as long as there is room."""
        record, vehicle, tracks = output.record, output.vehicle, self._tracks
        time_us = record.time_unix_us if isinstance(record, AttitudeRecord) else output.time_unix_us
        self._now_us = time_us or self._now_us
        if not self._now_us:
            return
        free = {*range(MOST_VEHICLES)} - {track.place for track in tracks.values()}
        if vehicle not in tracks and not free:
            if not self._has_left_out:
                self.message(f"only the first {MOST_VEHICLES} vehicles are drawn", self._now_us)
            self._has_left_out = True
            return
        if vehicle not in tracks:
            tracks[vehicle] = Track(records.vehicle_name(vehicle), min(free), self)
        self._flushed_us = self._flushed_us or self._now_us
        if isinstance(record, AttitudeRecord):
            tracks[vehicle].take_attitude(record, output)
        else:
            tracks[vehicle].take_status(record, self._now_us)


class Track:
    """The points of one vehicle, drawn at a ``place`` in the row of vehicles."""

    def __init__(self, name: str, place: int, stream: ViewerStream) -> None:
        self.place = place
        self._name = name
        self._stream = stream
        self._due_us: dict[str, int] = {}  # when the next point of a source is drawn
        self._statuses: tuple[StatusRecord | None, ...] = (None, None)  # the latest, and before
        self._state: State | None = None
        self._verdict: tuple[Level | None, int] = (None, 0)  # logged last, and when
        self._angles_deg: dict[str, Sequence[float]] = {}  # of the points before
        self._log = stream.recording.log
        self._log(f"/bodies/{name}", rr.ViewCoordinates.FRD, static=True)
        origin = rr.Transform3D(translation=(0.0, APART_M * place, 0.0))
        self._log(f"/bodies/{name}", origin, static=True)
        for vector, colour in VECTORS.items():
            shape = rr.Arrows3D.from_fields(colors=colour, radii=0.015)
            self._log(f"/bodies/{name}/{vector}", shape, static=True)
        for path, plot in layout.PLOTS.items():
            self._name_lines(f"/{path}/{name}", list(plot.lines), list(plot.lines.values()))

    def take_status(self, status: StatusRecord, now_us: int) -> None:
        """Keep it for the verdict; where there is no attitude it brings the state."""
        self._statuses = (status, self._statuses[0])
        state = State(status.state)
        if state not in records.HAS_ATTITUDE:
            self._log_changes(state, None, now_us)

    def take_attitude(self, record: AttitudeRecord, output: records.Published) -> None:
        """Ours, with the sample that it comes from, and those of others."""
        now_us, sample = record.time_unix_us, output.sample
        self._stream.recording.set_time(TIMELINE, timestamp=1e-6 * now_us)
        if self._is_due("ours", now_us, record.q_ned_frd):
            sigma, confidence = record.sigma_deg, record.confidence
            self._add_curves(
                sigma=[sigma.inclination, sigma.heading],
                tilt=record.euler_deg[:2],
                heading=record.euler_deg[2:],
                error=[record.error],
                gain=[record.gain],
                confidence=[confidence.gravity, confidence.magnetic],
                rate=[*map(degrees, record.rate_rad_s)],
                bias=[*map(degrees, record.gyro_bias_rad_s)],
            )
            measured = []  # gravity and field, in NED by our attitude
            if sample is not None:
                measured.append(("gravity", sample.acc_m_s2, -1.0 / STANDARD_GRAVITY_M_S2))
                if sample.has_mag and (size := norm(sample.mag_gauss)) > 0.0:
                    measured.append(("field", sample.mag_gauss, 1.0 / size))
            for name, vector, factor in measured:
                arrow = scale(factor, rotate(record.q_ned_frd, vector))
                self._log(f"/bodies/{self._name}/{name}", rr.Arrows3D.from_fields(vectors=[arrow]))
            self._log_changes(State(record.state), record, now_us)
        for source, q_ned_frd in output.peers:
            if self._is_due(source, now_us, q_ned_frd):
                self._add_other(source, q_ned_frd, record)

    def _is_due(self, source: str, now_us: int, q_ned_frd: Quaternion) -> bool:
        """Whether to draw an attitude, whose body is drawn then; its shape comes with the first."""
        if 0 < self._due_us.get(source, 0) - now_us <= POINT_US:
            return False
        path = f"/bodies/{self._name}/{source}"
        if source not in self._due_us:
            colour, thickness = SOURCES[source], 0.03 if source == "ours" else 0.015
            self._log(path, rr.Arrows3D(vectors=_BODY, colors=colour, radii=thickness), static=True)
            for plot_path, plot in layout.PLOTS.items():
                if source != "ours" and plot.of_others:
                    names = [f"{source} {line}" for line in plot.of_others]
                    colours = [colour, (*colour, 130)][: len(names)]  # the second is paler
                    self._name_lines(f"/{plot_path}/{self._name}/{source}", names, colours)
        self._due_us[source] = now_us + POINT_US
        w, x, y, z = q_ned_frd
        self._log(path, rr.Transform3D(quaternion=(x, y, z, w)))
        return True

    def _name_lines(self, path: str, names: list[str], colours: Sequence[layout.Colour]) -> None:
        lines = rr.SeriesLines(names=[f"{self._name} {name}" for name in names], colors=colours)
        self._log(path, lines, static=True)

    def _add_curves(self, of: str = "", **values: Sequence[float]) -> None:
        """Points by plot, of ours or another's; a gap where an angle wraps round."""
        for plot, now in values.items():
            path, points = f"/{plot}/{self._name}{of}", now
            if plot in ANGLES:
                pairs = zip(self._angles_deg.get(path, now), now, strict=True)
                points = [nan if abs(new - old) > 180.0 else new for old, new in pairs]
                self._angles_deg[path] = now
            self._log(path, rr.Scalars(points))

    def _add_other(self, source: str, q_ned_frd: Quaternion, ours: AttitudeRecord) -> None:
        """Another's angles, and how far it is from ours.

        That is left out live in a fast turn: there the time between two messages makes a larger
        angle than what they differ by.
        """
        angles_deg, of = euler_deg(q_ned_frd), f"/{source}"
        self._add_curves(of, tilt=angles_deg[:2], heading=angles_deg[2:])
        if not (self._stream.is_live and hypot(*ours.rate_rad_s) > FAST_RAD_S):
            self._add_curves(of, sigma=[degrees(angle_between(ours.q_ned_frd, q_ned_frd))])

    def _log_changes(self, state: State, record: AttitudeRecord | None, now_us: int) -> None:
        """Log a new state of health, and a new verdict on the attitude."""
        if state is not self._state:
            self._state = state
            self._stream.recording.set_time(TIMELINE, timestamp=1e-6 * now_us)
            self._log(f"/state/{self._name}", rr.StateChange(state=[state.value]))
            self._stream.message(f"vehicle {self._name}: {state}", now_us)
        now, (level, logged_us) = verdict_of(state, record, *self._statuses), self._verdict
        if now.overall is not level and not 0 <= now_us - logged_us < VERDICT_EVERY_US:
            self._verdict = now.overall, now_us
            why = ", ".join(caveat.text for caveat in now.caveats)
            text = f"vehicle {self._name}: {now.word}" + (f" ({why})" if why else "")
            self._stream.message(text, now_us)
