"""Bodies of a vehicle by several estimates in one place, sigma at the nose, and the vectors."""

from math import cos, hypot, pi, radians, sin
from typing import Any, NamedTuple

from estimator.geometry.quaternion import add, norm, rotate, scale
from estimator.profile import Reference
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample, Quaternion, Vec3
from fuzzbee.trust import Level
from fuzzbee.viewer.horizon import COLOURS, Colour
from fuzzbee.viewer.layout import AUTOPILOT, GREY, OURS, TRUTH
from fuzzbee.viewer.sdk import rr
from service.records import AttitudeRecord

OWN = "fuzzbee"
SOURCES: dict[str, Colour] = {OWN: OURS, "autopilot": AUTOPILOT, "sim": TRUTH}
FLAT = radians(60.0)  # a sigma is drawn up to here: its cone would open beyond the nose

NOSE: Vec3 = (0.8, 0.0, 0.0)
LEFT, RIGHT = (-0.5, -0.5, 0.0), (-0.5, 0.5, 0.0)
TAIL, TOP = (-0.3, 0.0, 0.0), (-0.35, 0.0, -0.2)
OUTLINE = [[NOSE, LEFT, TAIL, RIGHT, NOSE], [NOSE, TOP, TAIL], [LEFT, TOP, RIGHT]]
ORIGIN: Vec3 = (0.0, 0.0, 0.0)
RIB = 0.03
RIBS = tuple((-0.5 + 0.2 * (1.0 - abs(y) / 0.5), y, 0.0) for y in (0.1 * n for n in range(-5, 6)))
PALE: Colour = (150, 205, 255)
RING_POINTS = 24
RING = 0.95  # radius of the compass
FIELD_MEAN_S = 20.0  # the field that is expected, where it is learnt, is the mean of so long

GRAVITY_COLOUR, FIELD_COLOUR = (200, 60, 200), (0, 175, 190)


def compass() -> Any:
    """A level ring with north, east, south and west."""
    turn = [2.0 * pi * n / 48 for n in range(49)]
    ring = [(RING * cos(a), RING * sin(a), 0.0) for a in turn]
    marks = [
        [(RING * cos(a), RING * sin(a), 0.0), (0.9 * RING * cos(a), 0.9 * RING * sin(a), 0.0)]
        for a in turn[:-1:4]
    ]
    return rr.LineStrips3D([ring, *marks], colors=GREY, radii=0.004)


def compass_names() -> Any:
    """Names of its four points."""
    far = 1.08 * RING
    places = [(far, 0.0, 0.0), (0.0, far, 0.0), (-far, 0.0, 0.0), (0.0, -far, 0.0)]
    return rr.Points3D(
        places, labels=["N", "E", "S", "W"], colors=GREY, radii=0.001, show_labels=True
    )


class Line(NamedTuple):
    """A line in NED, so thick."""

    points: list[Vec3]
    radius: float
    colour: Colour


def solid(q_ned_frd: Quaternion) -> list[Line]:
    """Our own body: ribs that lie so close that they fill it, darker below its fin."""
    nose = rotate(q_ned_frd, NOSE)
    ribs = [Line([nose, rotate(q_ned_frd, end)], RIB, OURS) for end in RIBS]
    fin = [rotate(q_ned_frd, p) for p in (NOSE, TOP, TAIL)]
    return [*ribs, Line(fin, 0.6 * RIB, PALE)]


def outline(q_ned_frd: Quaternion, colour: Colour) -> list[Line]:
    """Somebody else's by its edges, to be seen around a solid one."""
    return [Line([rotate(q_ned_frd, p) for p in edge], 0.012, colour) for edge in OUTLINE]


def nose_range(attitude: AttitudeRecord, level: Level) -> Line:
    """An ellipse around the nose: heading's sigma wide and inclination's sigma high."""
    x, y, z = rotate(attitude.q_ned_frd, NOSE)
    flat, length = hypot(x, y), hypot(x, y, z)
    side = (-y / flat, x / flat, 0.0) if flat > 0.0 else (0.0, 1.0, 0.0)
    up = (-z * side[1] / length, z * side[0] / length, -flat / length)
    wide = length * sin(min(radians(attitude.sigma_deg.heading), FLAT))
    high = length * sin(min(radians(attitude.sigma_deg.inclination), FLAT))
    points: list[Vec3] = []
    for n in range(RING_POINTS + 1):
        a = wide * cos(2.0 * pi * n / RING_POINTS)
        b = high * sin(2.0 * pi * n / RING_POINTS)
        points.append(add((x, y, z), add(scale(a, side), scale(b, up))))
    return Line(points, 0.008, COLOURS[level])


class Vectors(NamedTuple):
    """Measured directions in NED by our attitude, and what they should be; None if unknown.

    Lengths are those of gravity and of the field that is expected.
    """

    gravity: Vec3
    field: Vec3 | None
    field_expected: Vec3 | None

    def lines(self) -> list[Line]:
        """Grey and thick what is expected, in colours what is measured, thicker at the ends."""
        drawn = [Line([ORIGIN, (0.0, 0.0, 1.0)], 0.022, GREY)]
        drawn += _arrow(self.gravity, GRAVITY_COLOUR)
        if self.field_expected is not None:
            drawn.append(Line([ORIGIN, self.field_expected], 0.022, GREY))
        if self.field is not None:
            drawn += _arrow(self.field, FIELD_COLOUR)
        return drawn


def _arrow(v: Vec3, colour: Colour) -> list[Line]:
    """A thin line with a thick end."""
    return [Line([ORIGIN, v], 0.013, colour), Line([scale(0.93, v), v], 0.03, colour)]


class FieldMean(NamedTuple):
    """The mean field in NED as our attitudes show it, over the last ``FIELD_MEAN_S``."""

    mean_gauss: Vec3 | None = None
    at_us: int = 0


def observe_field(state: FieldMean, field_ned_gauss: Vec3, now_us: int) -> FieldMean:
    """The mean after another reading."""
    if state.mean_gauss is None:
        return FieldMean(field_ned_gauss, now_us)
    dt_s = max(0.0, 1e-6 * (now_us - state.at_us))
    share = dt_s / (FIELD_MEAN_S + dt_s)
    x, y, z = (m + share * (b - m) for m, b in zip(state.mean_gauss, field_ned_gauss, strict=True))
    return FieldMean((x, y, z), now_us)


def vectors(
    q_ned_frd: Quaternion, sample: ImuSample, reference: Reference, mean: FieldMean
) -> Vectors:
    """What a sample measures, turned by the attitude, beside what the filter expects.

    Where the profile learns the field, its mean stands for what is expected.
    """
    gravity = scale(-1.0 / STANDARD_GRAVITY_M_S2, rotate(q_ned_frd, sample.acc_m_s2))
    fixed = None if reference.magnetic == "learn" else reference.magnetic
    size = norm(mean.mean_gauss or ORIGIN)
    if mean.mean_gauss is None or size <= 0.0:
        return Vectors(gravity, None, fixed)
    field = scale(1.0 / size, rotate(q_ned_frd, sample.mag_gauss)) if sample.has_mag else None
    return Vectors(gravity, field, fixed or scale(1.0 / size, mean.mean_gauss))
