"""One vehicle on a terminal: an artificial horizon in characters, with numbers and sigma.

Nothing is shown by colour alone: sky, ground, haze and the horizon's line have characters of their
own, and every sigma and caveat is written out. The haze around the line is as high as sigma.
Across the horizon x counts cells to the right and y halves of rows down, which are as high as cells
are wide.
"""

from itertools import groupby
from math import cos, floor, radians, sin
from typing import NamedTuple

import numpy as np
from rich.console import Console, Group
from rich.text import Text

from fuzzbee import verdict
from fuzzbee.latest import Row
from fuzzbee.verdict import Judgement, Level, heading_text
from service.records import AttitudeRecord, Autopilot

LEAST_WIDTH, LEAST_HEIGHT = 40, 12  # of a window that has room for it
PITCH_SPAN_DEG = 60.0  # shown from top to bottom
TAPE_DEG_PER_CELL = 2.5
RUNG_DEG = 10
STEEP = 0.7  # sine of the roll
BANK_DEG = (-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60)  # of the scale's ticks
OWN_SYMBOL = "━━━━━┓  ●  ┏━━━━━"  # the vehicle
THEIRS = "◆"  # the autopilot's horizon and heading, where they differ from ours
THEIRS_EVERY = 4  # columns
COMPASS = "◇"  # the compass's own heading, where it disagrees
ASCII = str.maketrans("━┓┏●▲▼·◆◇─╳█▀▄▒░", "=..o^v'AC-X---~:")  # where there is no Unicode

SKY, GROUND, HAZE, LINE = range(4)
# Sky, ground, haze by its level, and the line
PLAIN = ("  ▒▄", " ░▒▄", "▒▒▒▄", "▀▀▀█")  # without colours: by the upper and the lower half
PAINT = ("rgb(38,98,168)", "rgb(116,78,40)", "rgb(160,172,178)", "bright_white")
PAINTED_HAZE = {Level.CARE: "rgb(214,160,64)", Level.BAD: "rgb(178,84,74)"}
PAINT_16 = ("blue", "yellow", "bright_black", "bright_white")  # yellow is brown on many
PAINTED_HAZE_16 = {Level.CARE: "bright_yellow", Level.BAD: "red"}
LEVEL_COLOUR = dict(zip(Level, ("green", "yellow", "red", "red"), strict=True))
LEVEL_STYLE = {
    level: f"{'white' if c == 'red' else 'black'} on {c}" for level, c in LEVEL_COLOUR.items()
}


class _Scene(NamedTuple):
    """What the horizon is drawn of, and its size."""

    attitude: AttitudeRecord
    judged: Judgement
    other: Autopilot | None  # the autopilot's, if it differs
    compass_deg: float | None  # the compass's heading less ours, if they differ
    width: int
    rows: int

    def halves(self, angle_deg: float) -> float:
        """How high an angle is, in halves of rows."""
        return angle_deg * 2.0 * self.rows / PITCH_SPAN_DEG

    def in_sight(self, pitch_deg: float) -> float:
        """How far below the middle a horizon is drawn, however steep the vehicle."""
        return max(1.0 - self.rows, min(self.rows - 1.0, self.halves(pitch_deg)))

    def cell(self, x: float, y: float, roll_deg: float) -> tuple[int, int]:
        """Column and row of a place that the roll turns about the middle."""
        c, s = cos(radians(roll_deg)), sin(radians(roll_deg))
        return floor(self.width / 2 + x * c + y * s), floor((self.rows - x * s + y * c) / 2)


def screen(row: Row, width: int, height: int, console: Console, message: str = "") -> Group:
    """``height`` lines of ``width`` cells: state, heading, horizon, figures, caveats."""
    attitude, judged = row.valid_attitude, verdict.row_verdict(row)
    caveats = Text()
    for caveat in judged.caveats:  # the worst first, as many as fit
        if len(caveats) + len(caveat.text) + 3 > width:
            break
        caveats.append(f" {caveat.text} ", LEVEL_STYLE[caveat.level]).append(" ")
    tail = [*_figures(attitude, judged, width), caveats]
    rows = height - 2 - len(tail)  # less the bar and the message
    flight = "  ".join(row.flight_words)
    if attitude is None:
        drawn = _cross(judged, flight, width, rows)
    else:
        off = verdict.differing(row.status), verdict.compass_off_deg(row.status)
        scene = _Scene(attitude, judged, *off, width, rows - 2)  # less the tape
        drawn = [*_tape(scene), *_horizon(scene, flight, _paint(judged, console))]
    if not console.encoding.startswith("utf"):
        for line in drawn:
            line.plain = line.plain.translate(ASCII)
    return Group(_bar(row, judged, width), *drawn, *tail, Text(message[:width], style="dim"))


def _bar(row: Row, judged: Judgement, width: int) -> Text:
    """State at the left, the word that sums up in the middle, the IMU at the right."""
    right = f"{row.age_text} "
    if row.status is not None and row.status.imu_message is not None and width >= 60:
        right = f"{row.status.imu_message} {row.status.imu_rate_hz:.1f} Hz  {right}"
    word = f" {judged.word.upper()} "
    line = dict(enumerate(f" vehicle {row.name}  {row.state_text}"))
    line |= enumerate(right, width - len(right))
    line |= enumerate(word, (width - len(word)) // 2)
    return Text(_letters(line, width), f"bold {LEVEL_STYLE[judged.overall]}", no_wrap=True)


def _tape(scene: _Scene) -> list[Text]:
    """Directions as they pass under the middle; below them the range of sigma, and the other's."""
    attitude, width, other = scene.attitude, scene.width, scene.other
    yaw, middle = attitude.euler_deg[2], width // 2
    names, marks = dict[int, str](), dict[int, str]()
    has_north = attitude.heading_reference != "none"
    low = int(yaw - middle * TAPE_DEG_PER_CELL) // 15 * 15
    for degree in range(low, low + int(width * TAPE_DEG_PER_CELL) + 30, 15):
        point = verdict.POINTS.get(degree % 360) if has_north else None
        name = point or f"{degree % 360:03}"
        cell = middle + round((degree - yaw) / TAPE_DEG_PER_CELL)
        if degree % 45 == 0 or degree % 30 == 0:
            names |= enumerate(name, cell - len(name) // 2)
    # the vehicle's own mark would hide a band of no more than its cell
    reach = max(1, round(min(attitude.sigma_deg.heading, 180.0) / TAPE_DEG_PER_CELL))
    marks |= enumerate(("━" if has_north else "?") * (2 * reach + 1), middle - reach)
    theirs = other.heading_deg if other is not None and other.axis == "heading" else None
    for off_deg, letter in ((scene.compass_deg, COMPASS), (theirs, THEIRS)):
        if off_deg is not None:
            at = middle + round(off_deg / TAPE_DEG_PER_CELL)
            marks[max(0, min(width - 1, at))] = letter
    marks[middle] = "▲"
    number = f" {heading_text(attitude)} "
    begin = middle - len(number) // 2
    names |= enumerate(number, begin)
    line = Text(_letters(names, width))
    line.stylize("bold", begin, begin + len(number))
    return [line, Text(_letters(marks, width), style=LEVEL_COLOUR[scene.judged.heading])]


def _horizon(scene: _Scene, flight: str, paint: tuple[str, ...]) -> list[Text]:
    """Sky and ground, the haze of sigma and the line, in halves of cells, under the marks."""
    roll, pitch, _ = scene.attitude.euler_deg
    c, s = cos(radians(roll)), sin(radians(roll))
    x = np.arange(scene.width) + 0.5 - scene.width / 2
    y = np.arange(2 * scene.rows)[:, None] + 0.5 - scene.rows
    below = y * c + x * s - scene.in_sight(pitch)
    seen = np.where(below > 0.0, GROUND, SKY)
    seen[np.abs(below) <= scene.halves(scene.attitude.sigma_deg.inclination)] = HAZE
    seen[np.abs(below) <= 0.5 * (abs(c) + abs(s))] = LINE
    marks, lines = _marks(scene, flight), []
    for row, halves in enumerate(zip(seen[::2].tolist(), seen[1::2].tolist(), strict=True)):
        pairs = enumerate(zip(*halves, strict=True))
        cells = [_cell(*pair, marks.get((column, row)), paint) for column, pair in pairs]
        runs = groupby(cells, key=lambda cell: cell[1])  # of one style
        parts = [("".join(letter for letter, _ in alike), style) for style, alike in runs]
        lines.append(Text.assemble(*parts, no_wrap=True))
    return lines


def _paint(judged: Judgement, console: Console) -> tuple[str, ...]:
    """Colours of sky, ground, haze and line; none where the terminal has none."""
    if console.color_system is None:
        return ()
    few = console.color_system in ("standard", "windows")
    sky, ground, haze, line = PAINT_16 if few else PAINT
    return (sky, ground, (PAINTED_HAZE_16 if few else PAINTED_HAZE).get(judged.horizon, haze), line)


def _cell(upper: int, lower: int, mark: str | None, paint: tuple[str, ...]) -> tuple[str, str]:
    """The character and style of one cell; a mark hides what is under it."""
    if not paint:
        return mark or PLAIN[upper][lower], ""
    if mark is not None:
        seen = min(upper, lower)  # of line and haze the world behind
        ink_of = "bright_yellow" if mark in OWN_SYMBOL + THEIRS else "bright_white"
        return mark, f"bold {'black' if seen == HAZE else ink_of} on {paint[seen]}"
    if upper == lower:
        return " ", f"on {paint[upper]}"
    return "▀", f"{paint[upper]} on {paint[lower]}"


# --- marks: letters over sky and ground, by column and row


def _marks(scene: _Scene, flight: str) -> dict[tuple[int, int], str]:
    """Ladder, scale of bank, the other's horizon, the vehicle, mode and arming; the last win."""
    marks: dict[tuple[int, int], str] = {}
    roll, pitch, _ = scene.attitude.euler_deg
    # on its side there is less room from one rung to the next
    step = RUNG_DEG * (2 if abs(sin(radians(roll))) > STEEP else 1)
    for rung in range(-80, 81, step):
        text = f"─{rung}─"
        column, row = scene.cell(0.0, scene.halves(pitch - rung), roll)
        if rung != 0 and row > 0:  # the scale of bank begins in the first row
            begin = column - len(text) // 2
            marks |= {(begin + n, row): letter for n, letter in enumerate(text)}
    radius = min(scene.rows - 1.0, scene.width / 2.0 - 2.0)
    for turn_deg, letter in (*((tick, "·") for tick in BANK_DEG), (-roll, "▼")):
        marks[scene.cell(0.0, -radius, -turn_deg)] = letter
    other = scene.other
    if other is not None and other.axis == "inclination":  # dotted; never out of sight
        below = scene.in_sight(pitch + other.pitch_deg)
        for along in range(-scene.width, scene.width + 1, THEIRS_EVERY):
            marks[scene.cell(along, below, roll + other.roll_deg)] = THEIRS
    own = enumerate(OWN_SYMBOL, scene.width // 2 - len(OWN_SYMBOL) // 2)
    marks |= {(column, scene.rows // 2): letter for column, letter in own if letter != " "}
    return marks | {(1 + n, scene.rows - 1): letter for n, letter in enumerate(flight)}


# --- the rest of the screen


def _cross(judged: Judgement, flight: str, width: int, rows: int) -> list[Text]:
    """A cross in place of the horizon, and the reason."""
    reach = max(1, (rows - 5) // 2)
    grid: list[dict[int, str]] = [{} for _ in range(rows)]
    middle_row, middle = rows // 2, width // 2
    for step in range(-reach, reach + 1):
        grid[middle_row + step] = {middle - 2 * step: "╳", middle + 2 * step: "╳"}
    text = f"  {judged.word}: {judged.caveats[0].text}  "
    grid[middle_row] |= enumerate(text, middle - len(text) // 2)
    grid[-1] |= enumerate(flight, 1)
    style = f"bold {LEVEL_COLOUR[judged.overall]}"
    return [Text(_letters(row, width), style) for row in grid]


def _figures(attitude: AttitudeRecord | None, judged: Judgement, width: int) -> list[Text]:
    """Roll, pitch and heading, and the sigmas under them."""
    third = width // 3
    if attitude is None:
        empty = "".join(f"{name} ---".center(third) for name in ("roll", "pitch", "heading"))
        return [Text(empty), Text("")]
    roll, pitch, _ = attitude.euler_deg
    shown = (f"roll {roll:+.1f}°", f"pitch {pitch:+.1f}°", f"heading {heading_text(attitude)}")
    line = Text("".join(text.center(third) for text in shown), style="bold")
    horizon = f"horizon {judged.horizon_text}".center(2 * third)
    below = Text(horizon, style=LEVEL_COLOUR[judged.horizon], no_wrap=True)
    below.append(judged.heading_text.center(third), style=LEVEL_COLOUR[judged.heading])
    return [line, below]


def _letters(line: dict[int, str], width: int) -> str:
    """The letters of a line by their columns, as far as they fit."""
    return "".join(line.get(column, " ") for column in range(width))
