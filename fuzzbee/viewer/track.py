"""What is drawn of one vehicle: points wait here until they are sent as columns."""

from collections import defaultdict
from math import degrees, hypot, nan
from typing import Any, NamedTuple

from estimator.geometry.quaternion import angle_between, exp, multiply, norm, rotate, scale
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample, Quaternion, Vec3
from fuzzbee.trust import WORDS, Level, trust
from fuzzbee.viewer import layout
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import ViewerStream
from service.health import HAS_ATTITUDE, State
from service.records import AttitudeRecord, Peer, StatusRecord, euler_deg

POINTS_HZ = 10.0
PEER_SILENT_US = 2_000_000  # an older attitude of somebody else's is not drawn any more
FAST_RAD_S = 0.9  # 50 deg/s: a degree in the 20 ms that two messages are apart
VERDICT_EVERY_US = 1_000_000  # a change of the verdict is logged once a second at most
APART_M = 2.2  # between two vehicles, towards the east
SOURCES = {"ours": layout.OURS, "autopilot": layout.AUTOPILOT, "sim": layout.TRUTH}
RADII = {"ours": 0.03, "autopilot": 0.015, "sim": 0.015}
PEERS = ("autopilot", "sim")
UNKNOWN: Vec3 = (nan, nan, nan)
_BODY = [(0.8, 0.0, 0.0), (0.0, 0.45, 0.0), (0.0, 0.0, 0.25)]  # forward, right, down


class _Heard(NamedTuple):
    """The latest attitude by somebody else, and when it came: None until the next of ours."""

    q_ned_frd: Quaternion
    at_us: int | None = None


class Track:
    """The points of one vehicle, drawn at a ``place`` in the row of vehicles."""

    def __init__(self, name: str, place: int, stream: ViewerStream, is_live: bool) -> None:
        self.place = place
        self._name = name
        self._stream = stream
        self._is_live = is_live
        self._points: defaultdict[str, list[tuple[float, Any]]] = defaultdict(list)
        self._due_us = 0
        self._drawn: set[str] = set()  # whose bodies are drawn
        self._heard: dict[str, _Heard] = {}
        self._rate_rad_s: Vec3 = (0.0, 0.0, 0.0)
        self._status: StatusRecord | None = None
        self._before: StatusRecord | None = None
        self._state: State | None = None
        self._verdict: tuple[Level | None, int] = (None, 0)  # logged last, and when
        self._angles_deg: dict[str, list[float]] = {}  # of the points before
        self._introduce()

    def take_peer(self, peer: Peer) -> None:
        """Somebody else's attitude."""
        self._heard[peer.source] = _Heard(peer.q_ned_frd)

    def take_status(self, status: StatusRecord, now_us: int) -> None:
        """Keep it for the verdict; where there is no attitude it brings the state."""
        self._before, self._status = self._status, status
        state = State(status.state)
        if state not in HAS_ATTITUDE:
            self._log_changes(state, None, now_us)

    def take_attitude(self, record: AttitudeRecord, sample: ImuSample | None) -> None:
        """Ours, with the sample that it comes from."""
        now_us = record.time_unix_us
        for source, (q_ned_frd, at_us) in self._heard.items():
            self._heard[source] = _Heard(q_ned_frd, now_us if at_us is None else at_us)
        self._rate_rad_s = record.rate_rad_s
        if 0 < self._due_us - now_us <= round(1e6 / POINTS_HZ):
            return
        self._due_us = now_us + round(1e6 / POINTS_HZ)
        others = {source: self._now(heard, now_us) for source, heard in self._heard.items()}
        self._add_bodies(record, sample, others, 1e-6 * now_us)
        self._add_curves(record, [others.get(source) for source in PEERS], 1e-6 * now_us)
        self._log_changes(State(record.state), record, now_us)

    def flush(self) -> None:
        """Send all points that wait, one batch an entity."""
        for path, points in self._points.items():
            times, values = zip(*points, strict=True)
            self._stream.columns(path, times, _columns(path, values))
        self._points.clear()

    def _introduce(self) -> None:
        """Send shapes, names and colours, once."""
        static, name = self._stream.static, self._name
        origin = (0.0, APART_M * self.place, 0.0)
        static(f"/bodies/{name}", rr.ViewCoordinates.FRD)
        static(f"/bodies/{name}", rr.Transform3D(translation=origin))
        for vector, colour in (("gravity", layout.GRAVITY), ("field", layout.FIELD)):
            static(f"/bodies/{name}/{vector}", rr.Arrows3D.from_fields(colors=colour, radii=0.015))
        for path, plot in layout.PLOTS.items():
            names = [f"{name} {line}" for line in plot.lines]
            self._stream.lines(f"/{path}/{name}", names, list(plot.colours))

    def _now(self, heard: _Heard, now_us: int) -> Quaternion | None:
        """Another's attitude, turned on by the vehicle's rate since it came; None if it is old."""
        age_us = now_us - (heard.at_us or now_us)
        if abs(age_us) > PEER_SILENT_US:
            return None
        return multiply(heard.q_ned_frd, exp(scale(1e-6 * age_us, self._rate_rad_s)))

    def _add_bodies(
        self,
        record: AttitudeRecord,
        sample: ImuSample | None,
        others: dict[str, Quaternion | None],
        time_s: float,
    ) -> None:
        q_ned_frd, body = record.q_ned_frd, f"/bodies/{self._name}"
        for source, attitude in {"ours": q_ned_frd, **others}.items():
            if attitude is None:
                continue
            if source not in self._drawn:
                self._drawn.add(source)
                arrows = rr.Arrows3D(vectors=_BODY, colors=SOURCES[source], radii=RADII[source])
                self._stream.static(f"{body}/{source}", arrows)
            self._points[f"{body}/{source}"].append((time_s, attitude))
        if sample is None:
            return
        gravity = scale(-1.0 / STANDARD_GRAVITY_M_S2, rotate(q_ned_frd, sample.acc_m_s2))
        self._points[f"{body}/gravity"].append((time_s, gravity))
        size = norm(sample.mag_gauss)
        if sample.has_mag and size > 0.0:
            field = scale(1.0 / size, rotate(q_ned_frd, sample.mag_gauss))
            self._points[f"{body}/field"].append((time_s, field))

    def _add_curves(
        self, record: AttitudeRecord, others: list[Quaternion | None], time_s: float
    ) -> None:
        sigma = record.sigma_deg
        off = [nan if q is None else self._difference_deg(record, q) for q in others]
        angles = [record.euler_deg, *(UNKNOWN if q is None else euler_deg(q) for q in others)]
        values = {
            "sigma": [sigma.inclination, sigma.heading, *off],
            "tilt": self._cut("tilt", [x for each in angles for x in each[:2]]),
            "heading": self._cut("heading", [each[2] for each in angles]),
            "error": [record.error],
            "gain": [record.gain],
            "confidence": [record.confidence.gravity, record.confidence.magnetic],
            "rate": [degrees(x) for x in record.rate_rad_s],
            "bias": [degrees(x) for x in record.gyro_bias_rad_s],
        }
        for plot, numbers in values.items():
            self._points[f"/{plot}/{self._name}"].append((time_s, numbers))

    def _cut(self, plot: str, angles_deg: list[float]) -> list[float]:
        """Angles with a gap where one wraps round."""
        before = self._angles_deg.get(plot, angles_deg)
        self._angles_deg[plot] = angles_deg
        pairs = zip(before, angles_deg, strict=True)
        return [nan if abs(now - was) > 180.0 else now for was, now in pairs]

    def _difference_deg(self, record: AttitudeRecord, other: Quaternion) -> float:
        """How far another's attitude is from ours; NaN live in a fast turn.

        There the time between two messages makes a larger angle than what they differ by.
        """
        if self._is_live and hypot(*record.rate_rad_s) > FAST_RAD_S:
            return nan
        return degrees(angle_between(record.q_ned_frd, other))

    def _log_changes(self, state: State, record: AttitudeRecord | None, now_us: int) -> None:
        """Log a new state of health, and a new verdict on the attitude."""
        if state is not self._state:
            self._state = state
            self._stream.state(f"/state/{self._name}", state.value, now_us)
            self._stream.message(f"vehicle {self._name}: {state}", now_us)
        now, (level, logged_us) = trust(state, record, self._status, self._before), self._verdict
        if now.overall is not level and not 0 <= now_us - logged_us < VERDICT_EVERY_US:
            self._verdict = now.overall, now_us
            why = ", ".join(caveat.text for caveat in now.caveats)
            text = f"vehicle {self._name}: {WORDS[now.overall]}" + (f" ({why})" if why else "")
            self._stream.message(text, now_us)


def _columns(path: str, values: tuple[Any, ...]) -> Any:
    """The values of an entity as columns of its archetype."""
    if not path.startswith("/bodies/"):
        return rr.Scalars.columns(scalars=values)
    if len(values[0]) == 3:  # a vector
        return rr.Arrows3D.columns(vectors=values)
    return rr.Transform3D.columns(quaternion=[(x, y, z, w) for w, x, y, z in values])
