"""One vehicle on a terminal: an artificial horizon in characters, with numbers and sigma.

Nothing is said by colour alone: sky, ground, haze and the horizon's line have characters of their
own, and every sigma and caveat is written out. The haze around the line is as high as sigma.
"""

from collections.abc import Iterator
from itertools import groupby
from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
from rich.text import Text

from fuzzbee.table_model import Row, age_text, current_attitude, flight_words, state_text
from fuzzbee.verdict import (
    POINTS,
    Judgement,
    Level,
    heading_text,
    row_verdict,
)
from service.records import AttitudeRecord, Autopilot
from service.second_opinion import Verdict

LEAST_WIDTH, LEAST_HEIGHT = 40, 12  # of a window that has room for it
PITCH_SPAN_DEG = 60.0  # shown from top to bottom
CELL_RATIO = 2.0  # a cell is so much higher than wide
TAPE_DEG_PER_CELL = 2.5
RUNG_DEG = 10
STEEP = 0.7  # sine of the roll
BANK_DEG = (-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60)  # of the scale's ticks
OWN_SYMBOL = "━━━━━┓  ●  ┏━━━━━"  # the vehicle
THEIRS = "◆"  # the autopilot's horizon and heading, where they differ from ours
THEIRS_EVERY = 4  # columns
# Of a terminal without Unicode
ASCII = str.maketrans("━┓┏●▲▼·◆─╳█▀▄▒░", "=..o^v'A-X---~:")

SKY, GROUND, HAZE, LINE = range(4)
# Sky, ground, haze by its level, and the line
PAINT = ("rgb(38,98,168)", "rgb(116,78,40)", "rgb(160,172,178)", "bright_white")
PAINTED_HAZE = {Level.CARE: "rgb(214,160,64)", Level.BAD: "rgb(178,84,74)"}
PAINT_16 = ("blue", "yellow", "bright_black", "bright_white")  # yellow is brown on many
PAINTED_HAZE_16 = {Level.CARE: "bright_yellow", Level.BAD: "red"}
LEVEL_COLOUR = dict(zip(Level, ("green", "yellow", "red", "red"), strict=True))
LEVEL_STYLE = {
    level: f"{'white' if c == 'red' else 'black'} on {c}" for level, c in LEVEL_COLOUR.items()
}

Marks = dict[tuple[int, int], str]  # letters by column and row


class Capabilities(NamedTuple):
    """What the terminal can show; 0, 16 or more colours."""

    colours: int = 256
    unicode: bool = True


def has_room(width: int, height: int) -> bool:
    """Whether a window is large enough."""
    return width >= LEAST_WIDTH and height >= LEAST_HEIGHT


def screen(
    row: Row, now_s: float, width: int, height: int, capabilities: Capabilities, message: str = ""
) -> list[Text]:
    """``height`` lines of ``width`` cells: state, heading, horizon, figures, caveats."""
    attitude, judged = current_attitude(row, now_s), row_verdict(row, now_s)
    tail = [*_figures(attitude, judged, width), _caveats(judged, width)]
    rows = height - 2 - len(tail)  # less the bar and the message
    flight = "  ".join(flight_words(row))
    if attitude is None:
        drawn = _cross(judged, flight, width, rows)
    else:
        told = None if row.status is None else row.status.autopilot
        other = told if told is not None and told.verdict == Verdict.DIFFERS else None
        tape = _tape(attitude, judged, width, other)
        rows -= len(tape)
        marks = _marks(attitude, other, flight, width, rows)
        drawn = [*tape, *_horizon(attitude, _paint(judged, capabilities), marks, width, rows)]
    if not capabilities.unicode:
        for line in drawn:
            line.plain = line.plain.translate(ASCII)
    return [_bar(row, now_s, judged, width), *drawn, *tail, Text(message[:width], style="dim")]


def _bar(row: Row, now_s: float, judged: Judgement, width: int) -> Text:
    """State at the left, the word that sums up in the middle, the IMU at the right."""
    right = f"{age_text(row, now_s)} "
    if row.status is not None and row.status.imu_message is not None and width >= 60:
        right = f"{row.status.imu_message} {row.status.imu_rate_hz:.1f} Hz  {right}"
    word = f" {judged.word.upper()} "
    line = [" "] * width
    _write(line, 0, f" vehicle {row.name}  {state_text(row, now_s)}")
    _write(line, width - len(right), right)
    _write(line, (width - len(word)) // 2, word)
    return Text("".join(line), f"bold {LEVEL_STYLE[judged.overall]}", no_wrap=True)


def _tape(
    attitude: AttitudeRecord, judged: Judgement, width: int, other: Autopilot | None
) -> list[Text]:
    """Directions as they pass under the middle; below them the range of sigma, and the other's."""
    yaw, middle = attitude.euler_deg[2], width // 2
    names, marks = [" "] * width, [" "] * width
    has_north = attitude.heading_reference != "none"
    low = int(yaw - middle * TAPE_DEG_PER_CELL) // 15 * 15
    for degree in range(low, low + int(width * TAPE_DEG_PER_CELL) + 30, 15):
        point = POINTS.get(degree % 360) if has_north else None
        name = point or f"{degree % 360:03}"
        cell = middle + round((degree - yaw) / TAPE_DEG_PER_CELL)
        if degree % 45 == 0 or degree % 30 == 0:
            _write(names, cell - len(name) // 2, name)
    # the vehicle's own mark would hide a band of no more than its cell
    reach = max(1, round(min(attitude.sigma_deg.heading, 180.0) / TAPE_DEG_PER_CELL))
    _write(marks, middle - reach, ("━" if has_north else "?") * (2 * reach + 1))
    if other is not None and other.axis == "heading":
        at = middle + round(other.heading_deg / TAPE_DEG_PER_CELL)
        marks[max(0, min(width - 1, at))] = THEIRS
    marks[middle] = "▲"
    number = f" {heading_text(attitude)} "
    begin = middle - len(number) // 2
    _write(names, begin, number)
    line = Text("".join(names))
    line.stylize("bold", begin, begin + len(number))
    return [line, Text("".join(marks), style=LEVEL_COLOUR[judged.heading])]


def _horizon(
    attitude: AttitudeRecord, paint: tuple[str, ...], marks: Marks, width: int, rows: int
) -> list[Text]:
    """Sky and ground, the haze of sigma and the line, in halves of cells, under the marks."""
    halves = _halves(attitude, width, rows)
    lines = []
    for row in range(rows):
        pairs = enumerate(zip(halves[2 * row], halves[2 * row + 1], strict=True))
        cells = [_cell(*pair, marks.get((column, row)), paint) for column, pair in pairs]
        lines.append(Text.assemble(*_runs(cells), no_wrap=True))
    return lines


def _runs(cells: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Letters of one style together."""
    for style, alike in groupby(cells, key=lambda cell: cell[1]):
        yield "".join(letter for letter, _ in alike), style


def _halves(attitude: AttitudeRecord, width: int, rows: int) -> list[list[int]]:
    """What the upper and the lower halves of all cells show: as high as cells are wide."""
    roll, pitch, _ = attitude.euler_deg
    per_deg = 2.0 * rows / PITCH_SPAN_DEG  # halves to a degree
    c, s = cos(radians(roll)), sin(radians(roll))
    shift = _in_sight(pitch * per_deg, rows)
    x = np.arange(width) + 0.5 - width / 2
    y = np.arange(2 * rows)[:, None] + 0.5 - rows
    below = y * c + x * s - shift
    seen = np.where(below > 0.0, GROUND, SKY)
    seen[np.abs(below) <= attitude.sigma_deg.inclination * per_deg] = HAZE
    seen[np.abs(below) <= 0.5 * (abs(c) + abs(s))] = LINE
    halves: list[list[int]] = seen.tolist()
    return halves


def _paint(judged: Judgement, capabilities: Capabilities) -> tuple[str, ...]:
    """Colours of sky, ground, haze and line; none where the terminal has none."""
    if not capabilities.colours:
        return ()
    few = capabilities.colours <= 16
    sky, ground, haze, line = PAINT_16 if few else PAINT
    return (sky, ground, (PAINTED_HAZE_16 if few else PAINTED_HAZE).get(judged.horizon, haze), line)


def _cell(upper: int, lower: int, mark: str | None, paint: tuple[str, ...]) -> tuple[str, str]:
    """The character and style of one cell; a mark hides what is under it."""
    if not paint:
        return mark or _plain(upper, lower), ""
    if mark is not None:
        seen = min(upper, lower)  # of line and haze the world behind
        ink_of = "bright_yellow" if mark in OWN_SYMBOL + THEIRS else "bright_white"
        return mark, f"bold {'black' if seen == HAZE else ink_of} on {paint[seen]}"
    if upper == lower:
        return " ", f"on {paint[upper]}"
    return "▀", f"{paint[upper]} on {paint[lower]}"


def _plain(upper: int, lower: int) -> str:
    """Without colours: the line, else haze, else sky or ground."""
    if LINE in (upper, lower):
        return "█" if upper == lower else "▀" if upper == LINE else "▄"
    if HAZE in (upper, lower):
        return "▒"
    return "░" if lower == upper == GROUND else " "


# --- marks: letters over sky and ground


def _marks(
    attitude: AttitudeRecord, other: Autopilot | None, flight: str, width: int, rows: int
) -> Marks:
    """Ladder, scale of bank, the other's horizon, the vehicle, mode and arming; the last win."""
    marks = dict(_ladder(attitude, width, rows))
    marks |= _bank_scale(attitude, width, rows)
    if other is not None and other.axis == "inclination":
        marks |= _other_line(attitude, other, width, rows)
    left = width // 2 - len(OWN_SYMBOL) // 2
    own = enumerate(OWN_SYMBOL, left)
    marks |= {(column, rows // 2): letter for column, letter in own if letter != " "}
    return marks | {(1 + n, rows - 1): letter for n, letter in enumerate(flight)}


def _ladder(
    attitude: AttitudeRecord, width: int, rows: int
) -> Iterator[tuple[tuple[int, int], str]]:
    """The pitch every ten degrees, with its number, where it lies level enough to be written."""
    roll, pitch, _ = attitude.euler_deg
    per_deg = rows / PITCH_SPAN_DEG  # rows to a degree
    c, s = cos(radians(roll)), sin(radians(roll))
    # on its side there is less room from one to the next
    for rung in range(-80, 81, RUNG_DEG * (2 if abs(s) > STEEP else 1)):
        off = (pitch - rung) * per_deg
        row, text = int(rows / 2 + off * c), f"─{rung}─"
        begin = int(width / 2 + off * s * CELL_RATIO - len(text) / 2)
        if rung != 0 and 0 < row < rows:  # the scale of bank begins in the first row
            yield from (((begin + n, row), letter) for n, letter in enumerate(text))


def _bank_scale(attitude: AttitudeRecord, width: int, rows: int) -> Marks:
    """Ticks on an arc above the vehicle, and a pointer that stays at the zenith's side."""
    radius = min(rows - 1.0, width / 2.0 - 2.0)  # columns, or halves of rows
    marks = {}
    for turn_deg, letter in (*((tick, "·") for tick in BANK_DEG), (-attitude.euler_deg[0], "▼")):
        c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
        marks[int(width / 2 + radius * s), int((rows - radius * c) / 2)] = letter
    return marks


def _other_line(attitude: AttitudeRecord, other: Autopilot, width: int, rows: int) -> Marks:
    """Where the autopilot says that the horizon is, dotted; never out of sight."""
    roll, pitch, _ = attitude.euler_deg
    c, s = cos(radians(roll + other.roll_deg)), sin(radians(roll + other.roll_deg))
    below = _in_sight((pitch + other.pitch_deg) * 2.0 * rows / PITCH_SPAN_DEG, rows)
    dots = {}
    for along in range(-width, width + 1, THEIRS_EVERY):
        column, row = width / 2 + along * c + below * s, (rows - along * s + below * c) / 2
        if 0 <= column < width and 0 <= row < rows:
            dots[int(column), int(row)] = THEIRS
    return dots


def _in_sight(shift: float, rows: int) -> float:
    """Where the horizon is drawn, in halves of rows below the middle, however steep the vehicle."""
    return max(1.0 - rows, min(rows - 1.0, shift))


# --- the rest of the screen


def _cross(judged: Judgement, flight: str, width: int, rows: int) -> list[Text]:
    """A cross in place of the horizon, and the reason."""
    reach = max(1, (rows - 5) // 2)
    grid = [[" "] * width for _ in range(rows)]
    middle_row, middle = rows // 2, width // 2
    for step in range(-reach, reach + 1):
        for side in (-1, 1):
            column = middle + round(side * step * CELL_RATIO)
            if 0 <= column < width:
                grid[middle_row + step][column] = "╳"
    text = f"  {judged.word}: {judged.caveats[0].text}  "
    _write(grid[middle_row], middle - len(text) // 2, text)
    _write(grid[-1], 1, flight)
    return [Text("".join(row), style=f"bold {LEVEL_COLOUR[judged.overall]}") for row in grid]


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
    below = Text(horizon, style=LEVEL_COLOUR[judged.horizon])
    below.append(judged.heading_text.center(third), style=LEVEL_COLOUR[judged.heading])
    return [line, below]


def _caveats(judged: Judgement, width: int) -> Text:
    """The reasons, the worst first, as many as fit."""
    line = Text()
    for caveat in judged.caveats:
        if len(line) + len(caveat.text) + 3 > width:
            break
        line.append(f" {caveat.text} ", LEVEL_STYLE[caveat.level])
        line.append(" ")
    return line


def _write(line: list[str], at: int, text: str) -> None:
    """Put a text into a line, as much of it as fits."""
    for n, letter in enumerate(text):
        if 0 <= at + n < len(line):
            line[at + n] = letter
