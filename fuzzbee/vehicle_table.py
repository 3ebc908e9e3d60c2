"""Vehicles as a table that fits a terminal, and as plain lines."""

from collections import Counter
from collections.abc import Callable

from msgspec.structs import astuple
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from fuzzbee.latest import Row
from fuzzbee.notify import printable
from fuzzbee.verdict import Level, imus_off, verdict_of, warning_texts
from service.alarms import Alarm
from service.records import AttitudeRecord, State, StatusRecord

MAX_LINES = 8  # more vehicles than this share one line
MOST_WARNINGS = 3  # lines below the table
FRAME_LINES = 4  # title and header above the rows, summary and cursor below them
LONGEST_IMU, LONGEST_MODE = 16, 11  # letters of its message, and of a flight mode
BLOCK_GAP = 3  # between blocks of rows that stand side by side
# Windows at least so wide have more columns; those of the last have wider gaps, too.
COMPACT, NORMAL, MODES, WIDE, SPACIOUS = 58, 72, 84, 96, 108
COLOURS = {  # of a state; those that need attention come first
    State.LOST: "red",
    State.DEGRADED: "yellow",
    State.WAITING: "dim",
    State.ALIGNING: "cyan",
    State.RUNNING: "green",
}
# Of a sigma, by how good the attitude is with it
SIGMA_COLOURS = {Level.GOOD: "", Level.CARE: "yellow", Level.BAD: "red", Level.NONE: "red"}
ARROWS = "↑↗→↘↓↙←↖"  # the heading, north up

ID_WIDTH = 3  # with a component longer
# Columns as wide as their values can be: nothing moves about. A window that is less wide than the
# number before one leaves it out.
COLUMNS = (
    (0, Column("id", min_width=ID_WIDTH, no_wrap=True)),
    (0, Column("state", min_width=9, no_wrap=True)),
    (MODES, Column("mode", min_width=11, no_wrap=True)),
    (0, Column("roll", justify="right", min_width=7, no_wrap=True)),
    (0, Column("pitch", justify="right", min_width=6, no_wrap=True)),
    (COMPACT, Column("tilt ±", justify="right", min_width=6, no_wrap=True)),
    (0, Column("heading", justify="right", min_width=8, no_wrap=True)),
    (COMPACT, Column("head ±", justify="right", min_width=6, no_wrap=True)),
    (NORMAL, Column("gain", justify="right", min_width=5, no_wrap=True)),
    (WIDE, Column("IMU", min_width=11, no_wrap=True)),
    (NORMAL, Column("IMU Hz", justify="right", min_width=6, no_wrap=True)),
    (0, Column("age", justify="right", min_width=6, no_wrap=True)),
)


def table(
    rows: list[Row], width: int, height: int, title: str, keys: str = "", cursor: str | None = None
) -> RenderableType:
    """The rows that fit into ``height`` lines, those that need attention first if not all do.

    Where one column of rows is not enough, several stand side by side. ``keys`` is what keys do,
    ``cursor`` names the row that they are about.
    """
    warned = _warnings(rows, MOST_WARNINGS)
    room = max(1, height - FRAME_LINES - len(warned) - bool(keys))
    width -= max([0, *(len(row.name) - ID_WIDTH for row in rows)])
    across = max(1, min((width + BLOCK_GAP) // (COMPACT + BLOCK_GAP), -(-len(rows) // room)))
    # in their order: nothing jumps
    chosen = {row.name for row in sorted(rows, key=_attention)[: room * across]}
    shown = [row for row in rows if row.name in chosen]
    hidden = [row for row in rows if row.name not in chosen]
    each = max(1, -(-len(shown) // across))
    blocks = Table.grid(padding=(0, BLOCK_GAP, 0, 0))
    within = width if across == 1 else COMPACT
    starts = range(0, max(1, len(shown)), each)
    blocks.add_row(*(_block(shown[n : n + each], within, cursor) for n in starts))
    parts: list[RenderableType] = [Text(title, style="bold", no_wrap=True), blocks]
    if not rows:
        parts.append(Text("waiting for a vehicle", style="dim italic"))
    if hidden:
        parts.append(Text(f"… {summary(hidden, 'more')}", style="dim italic"))
    if keys:
        parts.append(Text(keys, style="dim", no_wrap=True))
    parts += [Text(text, style="yellow", no_wrap=True, overflow="ellipsis") for text in warned]
    return Group(*parts)


def _block(rows: list[Row], width: int, cursor: str | None) -> Table:
    gap = 2 if width >= SPACIOUS else 1
    columns = [column.copy() for least, column in COLUMNS if least <= width]
    view = Table(*columns, box=None, header_style="bold", padding=(0, gap, 0, 0), pad_edge=False)
    for row in rows:
        style, cells = "reverse" if row.name == cursor else None, _cells(row)
        view.add_row(*(cells.get(str(column.header), "") for column in columns), style=style)
    return view


def _warnings(rows: list[Row], most: int) -> list[str]:
    """Lines on what contradicts an attitude; the last one counts those that have no room."""
    statuses = [(row.name, row.status) for row in rows if row.status is not None]
    texts, overloaded = [], [status for _, status in statuses if status.overloaded]
    if overloaded:
        shed = sum(status.shed for status in overloaded)
        slowest_hz = min(status.published_hz for status in overloaded)
        texts += [f"! overloaded: {shed} samples left out so far, attitudes at {slowest_hz:.1f} Hz"]
    for name, status in statuses:
        words = [*(warning_texts(word, status)[1] for word in status.warnings), *imus_off(status)]
        texts += [f"! vehicle {name}: {word}" for word in words]
    if len(texts) <= most:
        return texts
    return [*texts[: most - 1], f"! and {len(texts) - most + 1} more warnings"]


# --- plain lines


def lines(rows: list[Row]) -> list[str]:
    """A line a vehicle, or one line for many."""
    if len(rows) > MAX_LINES:
        return [summary(rows, "vehicles")]
    return [_line(row) for row in rows]


def summary(rows: list[Row], noun: str) -> str:
    """How many there are in which state."""
    counts = Counter(row.state for row in rows)
    parts = [f"{counts[state]} {state}" for state in COLOURS if state in counts]
    return f"{len(rows)} {noun}: {', '.join(parts)}"


def _line(row: Row) -> str:
    start = f"{row.name:>5}  {row.state_text:<9}"
    attitude = row.valid_attitude
    if attitude is None:
        return start
    roll, pitch, _ = attitude.euler_deg
    sigma = attitude.sigma_deg
    flight = "".join(f"  {word}" for word in row.flight_words)
    return (
        f"{start} roll {roll:+7.1f}  pitch {pitch:+6.1f} {_plus_minus(sigma.inclination):<6}"
        f"  heading {_heading(attitude)} {_plus_minus(sigma.heading):<6}"
        f"  K {attitude.gain:5.1f}  {_rate(row):>6} Hz"
        f"  age {row.age_text}{flight}{_words(row.status)}"
    )


def _words(status: StatusRecord | None) -> str:
    """The warnings, for the end of a line."""
    if status is None:
        return ""
    differs = Alarm.AUTOPILOT_DIFFERS.value
    in_short = {} if status.autopilot is None else {differs: status.autopilot.in_short}
    words = [in_short.get(word, word) for word in status.warnings]
    words = ["overloaded"] * status.overloaded + words + imus_off(status)
    return "".join(f"  ! {printable(word, 40)}" for word in words)


# --- orders of rows


def _attention(row: Row) -> int:
    is_warned = row.status is not None and bool(row.status.warnings)
    return 2 * [*COLOURS].index(row.state) - is_warned


ORDERS: dict[str, Callable[[Row], float]] = {
    "name": lambda _: 0.0,  # as the rows come
    "attention": _attention,
    "sigma": lambda row: -max(astuple(row.attitude.sigma_deg)) if row.attitude else 0.0,
}


# --- cells


def _cells(row: Row) -> dict[str, str | Text]:
    """What the columns show, by their names; nothing of an attitude that is not valid."""
    status, attitude = row.status, row.valid_attitude
    cells: dict[str, str | Text] = {
        "id": Text(row.name),
        "state": _state(row),
        "IMU": ((status and status.imu_message) or "")[:LONGEST_IMU],
        "IMU Hz": _rate(row),
        "age": row.age_text,
    }
    if status is not None and not row.is_silent:  # a full circle if it is armed
        mark = {None: "", True: "●", False: "○"}[status.armed]
        cells["mode"] = Text(f"{mark}{status.mode}"[:LONGEST_MODE])
    if attitude is not None:
        judged, sigma = verdict_of(State(attitude.state), attitude), attitude.sigma_deg
        has_north = attitude.heading_reference != "none"
        arrow = f" {ARROWS[round(attitude.euler_deg[2] / 45.0) % 8]}" if has_north else ""
        cells |= {
            "roll": f"{attitude.euler_deg[0]:+.1f}°",
            "pitch": f"{attitude.euler_deg[1]:+.1f}°",
            "tilt ±": Text(_plus_minus(sigma.inclination), SIGMA_COLOURS[judged.horizon]),
            "heading": f"{_heading(attitude)}°{arrow}".rjust(8),
            "head ±": Text(_plus_minus(sigma.heading), SIGMA_COLOURS[judged.heading]),
            "gain": f"{attitude.gain:.1f}",
        }
    return cells


def _state(row: Row) -> Text:
    """The state; with a mark and in yellow where something contradicts it, or the autopilot."""
    words = () if row.status is None or row.is_silent else row.status.warnings
    if words:
        mark = "≠" if Alarm.AUTOPILOT_DIFFERS in words else "!"
        return Text(f"{row.state_text}{mark}", style="bold yellow")
    return Text(row.state_text, style=COLOURS[row.state])


def _rate(row: Row) -> str:
    return f"{row.status.imu_rate_hz:.1f}" if row.status is not None else "?"


def _plus_minus(sigma_deg: float) -> str:
    return f"±{sigma_deg:.1f}°" if sigma_deg < 99.95 else f"±{sigma_deg:.0f}°"


def _heading(attitude: AttitudeRecord) -> str:
    """Three digits before the point; in brackets if it refers to nothing."""
    text = f"{round(attitude.euler_deg[2], 1) % 360:05.1f}"
    return f"({text})" if attitude.heading_reference == "none" else text
