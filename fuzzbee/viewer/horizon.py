"""An artificial horizon with numbers, heading tape, sigma, state and caveats, as plain strips.

A strip is a line with a radius and a colour; a thick one fills an area. Later strips cover
earlier ones. The unit is the instrument's own, x to the right, y down, the middle of the window
at (0, 0); what lies beyond the bounds is filled, too, since a window is seldom of their shape.
"""

from collections.abc import Iterator
from math import cos, isnan, radians, sin
from typing import NamedTuple

from fuzzbee.trust import POINTS, Level, Trust, heading_text, is_on_its_back, north_text, plus_minus
from fuzzbee.viewer.strokes import Point, text_strokes, width
from service.attitude_record import euler_deg
from service.health import State
from service.records import AttitudeRecord, Peer

Colour = tuple[int, int, int]

X_RANGE, Y_RANGE = (-160.0, 160.0), (-140.0, 136.0)
FAR = 2000.0  # beyond every window
PER_DEG = 2.2  # of pitch
TAPE_PER_DEG = 3.2  # of heading
MIDDLE_Y = 4.0  # of the horizon's part
SLIVER = 84.0  # the horizon's line is kept in sight, however steep the vehicle
BAR_Y, TAPE_Y, FIGURES_Y = -118.0, -96.0, 98.0  # where bar and tape end, and the figures begin
ARC = 84.0  # radius of the roll's scale
FIGURES_RADIUS = 0.8  # the same for all lines of the figures, so that radii need not be sent anew
FIGURES_X = (-110.0, 0.0, 110.0)
RUNG_DEG, RUNGS = 10, 3  # of the ladder: so many above and below the middle
PLATE_STEP = 13.0  # from one caveat to the next
MOST_CAVEATS = 5

SKY: Colour = (46, 108, 178)
GROUND: Colour = (116, 78, 40)
GREY_SKY: Colour = (120, 120, 120)  # where the attitude is old
GREY_GROUND: Colour = (84, 84, 84)
STALE_MS = 1000.0
PANEL: Colour = (22, 24, 28)
WHITE: Colour = (245, 245, 245)
PALE: Colour = (165, 170, 178)
OWN: Colour = (255, 214, 0)
COLOURS: dict[Level, Colour] = {
    Level.GOOD: (60, 190, 90),
    Level.CARE: (255, 176, 32),
    Level.BAD: (235, 64, 52),
    Level.NONE: (235, 64, 52),
}
# Where the horizon may be as well: a haze over sky and ground
HAZE: dict[Level, Colour] = {
    Level.GOOD: (176, 196, 206),
    Level.CARE: (222, 176, 96),
    Level.BAD: (176, 104, 92),
    Level.NONE: PANEL,
}
PEER_NAMES = {"autopilot": "autopilot", "sim": "truth"}
PEERS: dict[str, Colour] = {"autopilot": (255, 140, 40), "sim": (110, 235, 130)}


class Strip(NamedTuple):
    """A line through points, so thick."""

    points: list[Point]
    radius: float
    colour: Colour


class Scene(NamedTuple):
    """What the instrument shows of one vehicle; peers with how far off they are (deg, or NaN)."""

    name: str
    state: State
    attitude: AttitudeRecord | None  # None if it is not valid
    trust: Trust
    peers: tuple[tuple[Peer, float], ...] = ()
    note: str = ""  # beside the state: the IMU's message and rate
    differs: bool = False  # the autopilot's attitude from ours, for longer than a moment


class Layers(NamedTuple):
    """The instrument from back to front, apart by how fast its parts change.

    A browser that draws in software takes in little between two pictures, so that what stays
    as it is should not be sent again.
    """

    world: list[Strip]  # always as many strips, in the same colours unless trust changes
    words: list[Strip]
    figures: list[Strip]


def layers(scene: Scene) -> Layers:
    """The parts that move; the sky lies behind them, :func:`frame` behind all but the world."""
    return Layers(
        world=_world(scene),
        words=[
            *_nothing(scene),
            *_bar(scene),
            *_judgement(scene),
            *_caveats(scene),
            *_turns_to_peers(scene),
        ],
        figures=[*_tape(scene), *_numbers(scene)],
    )


def frame() -> list[Strip]:
    """What stands still: panels, the roll's scale, the vehicle itself, names."""
    middle = (BAR_Y + TAPE_Y) / 2.0
    below = FIGURES_Y + FAR / 2.0
    strips = [
        *_roll_scale(),
        *_own_symbol(),
        Strip([(-FAR, middle), (FAR, middle)], (TAPE_Y - BAR_Y) / 2.0, PANEL),
        Strip([(-FAR, below), (FAR, below)], FAR / 2.0, PANEL),
    ]
    for x, name in zip(FIGURES_X, ("roll", "pitch", "heading"), strict=True):
        strips += _text(name, (x, FIGURES_Y + 6.0), 5.0, PALE, 0.45)
    return strips


def _world(scene: Scene) -> list[Strip]:
    """Ground, the haze of sigma around the horizon's line, the ladder, the zenith, the others."""
    attitude = scene.attitude
    if attitude is None:
        return []
    roll, pitch, _ = attitude.euler_deg
    off = _line_offset(pitch)
    haze = min(attitude.sigma_deg.inclination * PER_DEG, FAR / 4.0)
    is_old = attitude.age_ms > STALE_MS
    return [
        Strip(_level_line(roll, off - FAR / 2.0, FAR), FAR / 2.0, GREY_SKY if is_old else SKY),
        Strip(
            _level_line(roll, off + FAR / 2.0, FAR), FAR / 2.0, GREY_GROUND if is_old else GROUND
        ),
        # in steps, so that it is sent when it has changed and not all the time
        Strip(
            _level_line(roll, off, FAR),
            max(0.8, round(haze * 2.0) / 2.0),
            HAZE[scene.trust.horizon],
        ),
        Strip(_level_line(roll, off, FAR), 0.7, WHITE),
        *(strip for peer, _ in scene.peers for strip in _other_horizon(peer)),
        *_ladder(attitude),
        _zenith(roll),
    ]


def _line_offset(pitch_deg: float) -> float:
    """How far below the middle the horizon's line is drawn: never out of sight."""
    return max(-SLIVER, min(SLIVER, pitch_deg * PER_DEG))


def _level_line(
    roll_deg: float, below: float, half: float, from_half: float | None = None
) -> list[Point]:
    """A line that is level in the world, ``below`` the middle along the vehicle's own vertical."""
    start = -half if from_half is None else from_half
    return [_place(roll_deg, start, below), _place(roll_deg, half, below)]


def _place(roll_deg: float, along: float, below: float) -> Point:
    """A point of the world's axes in the window: the vehicle rolls right, the world left."""
    c, s = cos(radians(roll_deg)), sin(radians(roll_deg))
    return (along * c + below * s, MIDDLE_Y - along * s + below * c)


def _ladder(attitude: AttitudeRecord) -> Iterator[Strip]:
    """The rungs of pitch that are nearest, every 10 degrees; the upright number is the tens."""
    roll, pitch, _ = attitude.euler_deg
    nearest = round(pitch / RUNG_DEG) * RUNG_DEG
    for rung in range(nearest - RUNGS * RUNG_DEG, nearest + (RUNGS + 1) * RUNG_DEG, RUNG_DEG):
        below = (pitch - rung) * PER_DEG
        half = 0.0 if rung == 0 or abs(rung) > 90 else 12.0 + abs(rung) / 5.0
        ends = _level_line(roll, below, half)
        # ends that point to the horizon, as on a real one
        hook = 4.0 if rung > 0 else -4.0 if rung < 0 else 0.0
        first, last = _place(roll, -half, below + hook), _place(roll, half, below + hook)
        yield Strip([first, *ends, last], 0.7, WHITE)


def _zenith(roll_deg: float) -> Strip:
    """Points to the world's zenith on the roll's scale."""
    tip, left, right = (
        _on_arc(-roll_deg + side * 4.0, ARC - (8.0 if side else 0.5)) for side in (0, -1, 1)
    )
    return Strip([tip, left, right, tip], 1.0, OWN)


def _roll_scale() -> Iterator[Strip]:
    """Marks of the roll."""
    yield Strip([_on_arc(angle, ARC) for angle in range(-60, 61, 5)], 0.4, WHITE)
    for angle in (-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60):
        length = 5.0 if angle % 30 == 0 else 3.0
        yield Strip([_on_arc(angle, ARC), _on_arc(angle, ARC + length)], 0.5, WHITE)


def _on_arc(angle_deg: float, radius: float) -> Point:
    """The point of the roll's scale at an angle from its top, clockwise, in degrees."""
    return (radius * sin(radians(angle_deg)), MIDDLE_Y - radius * cos(radians(angle_deg)))


def _own_symbol() -> list[Strip]:
    """The vehicle itself, which stands still."""
    wings = [
        [(-52.0, MIDDLE_Y), (-26.0, MIDDLE_Y), (-26.0, MIDDLE_Y + 6.0)],
        [(52.0, MIDDLE_Y), (26.0, MIDDLE_Y), (26.0, MIDDLE_Y + 6.0)],
        [(-1.0, MIDDLE_Y), (1.0, MIDDLE_Y)],
    ]
    return [Strip(wing, 2.4, PANEL) for wing in wings] + [Strip(wing, 1.5, OWN) for wing in wings]


def _other_horizon(peer: Peer) -> list[Strip]:
    """Somebody else's horizon at both sides, thin, in their colour."""
    roll, pitch, _ = euler_deg(peer.q_ned_frd)
    off, colour = _line_offset(pitch), PEERS[peer.source]
    return [
        Strip(_level_line(roll, off, side * 110.0, side * 62.0), 1.0, colour) for side in (-1, 1)
    ]


def _nothing(scene: Scene) -> list[Strip]:
    """A cross on grey, where there is no valid attitude."""
    if scene.attitude is not None:
        return []
    reach, middle = 58.0, (TAPE_Y + FIGURES_Y) / 2.0
    colour = COLOURS[Level.NONE]
    return [
        Strip([(-FAR, middle), (FAR, middle)], (FIGURES_Y - TAPE_Y) / 2.0, PANEL),
        Strip([(-reach, middle - reach), (reach, middle + reach)], 2.0, colour),
        Strip([(-reach, middle + reach), (reach, middle - reach)], 2.0, colour),
    ]


def _tape(scene: Scene) -> Iterator[Strip]:
    """Directions as they pass under the mark."""
    attitude = scene.attitude
    if attitude is None:
        return
    yaw = attitude.euler_deg[2]
    has_north = attitude.heading_reference != "none"
    low = int((yaw - 50.0) // 10 * 10)
    for degree in range(low, low + 111, 10):
        x = (degree - yaw) * TAPE_PER_DEG
        if abs(x) < 22.0:
            continue
        yield Strip([(x, TAPE_Y - 4.0), (x, TAPE_Y - 8.0)], FIGURES_RADIUS, WHITE)
        if degree % 30 == 0:
            name = POINTS.get(degree % 360) if has_north else None
            yield from _text(
                name or f"{degree % 360:03}", (x, BAR_Y + 6.5), 6.0, WHITE, FIGURES_RADIUS
            )


def _judgement(scene: Scene) -> Iterator[Strip]:
    """Both sigmas: on the tape around the heading's box, and in words under the figures."""
    attitude, middle = scene.attitude, (BAR_Y + TAPE_Y) / 2.0
    if attitude is None:
        return
    sigma, colour = attitude.sigma_deg, COLOURS[scene.trust.heading]
    reach = round(min(sigma.heading, 180.0) * TAPE_PER_DEG)
    yield Strip([(-reach, TAPE_Y - 1.5), (reach, TAPE_Y - 1.5)], 1.5, colour)
    if attitude.heading_reference != "none":
        for peer, _ in scene.peers:
            yield _other_heading(peer, attitude.euler_deg[2])
    box = [(-17.0, middle), (17.0, middle)]
    yield Strip(box, 8.6, colour)
    yield Strip(box, 7.6, PANEL)
    yield Strip([(0.0, middle + 8.0), (0.0, TAPE_Y + 1.0)], 0.9, OWN)
    y = FIGURES_Y + 32.0
    horizon = f"horizon {plus_minus(sigma.inclination)}"
    yield from _text(horizon, (-55.0, y), 6.5, COLOURS[scene.trust.horizon], 0.75)
    yield from _text(north_text(attitude), (FIGURES_X[2], y), 6.5, colour, 0.75)


def _other_heading(peer: Peer, yaw_deg: float) -> Strip:
    off = (euler_deg(peer.q_ned_frd)[2] - yaw_deg + 180.0) % 360.0 - 180.0
    x = max(-150.0, min(150.0, off * TAPE_PER_DEG))
    points = [(x - 2.5, TAPE_Y + 4.0), (x, TAPE_Y), (x + 2.5, TAPE_Y + 4.0)]
    return Strip(points, 0.8, PEERS[peer.source])


def _bar(scene: Scene) -> Iterator[Strip]:
    """One colour over the whole width, with the word that sums up."""
    colour = COLOURS[scene.trust.overall]
    yield Strip([(-FAR, BAR_Y - FAR / 2.0), (FAR, BAR_Y - FAR / 2.0)], FAR / 2.0, colour)
    y = (Y_RANGE[0] + BAR_Y) / 2.0
    yield from _text(scene.trust.word, (0.0, y), 11.0, PANEL, 1.2)
    left = X_RANGE[0] + 4.0
    yield from _text(scene.name, (left, y), 7.5, PANEL, 1.0, "left")
    left += width(scene.name, 7.5) + 5.0
    yield from _text(scene.state.value, (left, y), 5.0, PANEL, 0.5, "left")
    yield from _text(scene.note, (X_RANGE[1] - 4.0, y), 5.0, PANEL, 0.5, "right")


def _numbers(scene: Scene) -> Iterator[Strip]:
    """Roll, pitch and heading in large digits, and the heading once more under its mark."""
    attitude = scene.attitude
    if attitude is None:
        texts = ["---"] * 3
    else:
        roll, pitch, _ = attitude.euler_deg
        texts = [f"{roll:+.1f}°", f"{pitch:+.1f}°", heading_text(attitude)]
        yield from _text(texts[2], (0.0, (BAR_Y + TAPE_Y) / 2.0), 9.0, WHITE, FIGURES_RADIUS)
        yield from _text(age(attitude.age_ms), (32.0, FIGURES_Y + 32.0), 5.0, PALE, FIGURES_RADIUS)
    for x, text in zip(FIGURES_X, texts, strict=True):
        yield from _text(text, (x, FIGURES_Y + 18.0), 12.0, WHITE, FIGURES_RADIUS)


def age(age_ms: float) -> str:
    """How old the sample was when this was sent."""
    return f"age {age_ms:.0f} ms" if age_ms < STALE_MS else f"age {age_ms / 1e3:.1f} s"


def _caveats(scene: Scene) -> Iterator[Strip]:
    """The reasons, each on a plate of its own, at the left under the tape."""
    plates = [(caveat.text, COLOURS[caveat.level]) for caveat in scene.trust.caveats[:MOST_CAVEATS]]
    if is_on_its_back(scene.attitude):
        plates.append(("upside down", WHITE))
    for number, (text, colour) in enumerate(plates):
        y, left = TAPE_Y + 10.0 + PLATE_STEP * number, X_RANGE[0] + 8.0
        yield Strip([(left, y), (left + width(text, 6.0), y)], 5.6, colour)
        yield from _text(text, (left, y), 6.0, PANEL, 0.7, "left")


def _turns_to_peers(scene: Scene) -> Iterator[Strip]:
    """How far the others are off, in their colours, at the right under the tape."""
    for number, (peer, turn_deg) in enumerate(scene.peers if scene.attitude is not None else ()):
        y, right = TAPE_Y + 10.0 + PLATE_STEP * number, X_RANGE[1] - 8.0
        name = PEER_NAMES[peer.source]
        text = name if isnan(turn_deg) else f"{name} {turn_deg:.1f}°"
        colours = [PANEL, PEERS[peer.source]]
        if scene.differs and peer.source == "autopilot":
            colours.reverse()
        yield Strip([(right - width(text, 6.0), y), (right, y)], 5.6, colours[0])
        yield from _text(text, (right, y), 6.0, colours[1], 0.7, "right")


def _text(
    text: str, at: Point, size: float, colour: Colour, radius: float, align: str = "centre"
) -> Iterator[Strip]:
    for stroke in text_strokes(text, at, size, align):
        yield Strip(stroke, radius, colour)
