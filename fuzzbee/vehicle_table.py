"""Vehicles as a table that fits a terminal, and as plain lines."""

from collections.abc import Callable
from typing import NamedTuple

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from fuzzbee.say import printable
from fuzzbee.table_model import Row, age_text, current_attitude, is_silent, state_text
from fuzzbee.trust import Level, trust
from service.alarms import MEANINGS, Alarm
from service.health import State
from service.records import AttitudeRecord, StatusRecord

MAX_LINES = 8  # more vehicles than this share one line
MOST_WARNINGS = 3  # lines below the table
FRAME_LINES = 4  # title and header above the rows, summary and cursor below them
BLOCK_GAP = 3
# Columns as wide as their values can be, so that nothing moves about. An id may be longer: with a
# component; the longest IMU is HIGHRES_IMU.
WIDTHS = {
    "id": 3,
    "state": 9,
    "roll": 7,
    "pitch": 6,
    "tilt ±": 6,
    "heading": 8,
    "head ±": 6,
    "gain": 5,
    "bar": 8,  # the gain as a bar
    "IMU": 11,
    "IMU Hz": 6,
    "age": 6,
}
AT_THE_LEFT = ("id", "state", "bar", "IMU")  # of their columns
COLOURS = {
    State.WAITING: "dim",
    State.ALIGNING: "cyan",
    State.RUNNING: "green",
    State.DEGRADED: "yellow",
    State.LOST: "red",
}
# Of a sigma, by how far the attitude can be trusted with it
TRUST_COLOURS = {Level.GOOD: "", Level.CARE: "yellow", Level.BAD: "red", Level.NONE: "red"}
ATTENTION = (State.LOST, State.DEGRADED, State.WAITING, State.ALIGNING, State.RUNNING)
ARROWS = "↑↗→↘↓↙←↖"  # the heading, north up
BAR_FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100


class Layout(NamedTuple):
    """Which columns are left out where a line has at least ``width`` cells."""

    width: int
    left_out: tuple[str, ...] = ()
    gap: int = 1


WIDE = Layout(105, gap=2)
NORMAL = Layout(72, ("bar", "IMU"))
COMPACT = Layout(58, (*NORMAL.left_out, "gain", "IMU Hz"))
NARROW = Layout(0, (*COMPACT.left_out, "tilt ±", "head ±"))


class Look(NamedTuple):
    """What stands around the rows: a title, what keys do, and which row they are about."""

    title: str
    keys: str = ""
    cursor: str | None = None


def table(rows: list[Row], now_s: float, width: int, height: int, look: Look) -> RenderableType:
    """The rows that fit into ``height`` lines, those that need attention first if not all do.

    Where one column of rows is not enough, several stand side by side.
    """
    warned = _warnings(rows, MOST_WARNINGS)
    room = max(1, height - FRAME_LINES - len(warned) - bool(look.keys))
    width -= max([0, *(len(row.name) - WIDTHS["id"] for row in rows)])
    most = (width + BLOCK_GAP) // (COMPACT.width + BLOCK_GAP)
    across = min(most, -(-len(rows) // room))
    if across > 1:
        layout = COMPACT
    else:
        across = 1
        layout = next(fits for fits in (WIDE, NORMAL, COMPACT, NARROW) if fits.width <= width)
    shown = rows
    if len(rows) > room * across:
        chosen = {row.name for row in sorted(rows, key=_attention)[: room * across]}
        shown = [row for row in rows if row.name in chosen]  # in their order: nothing jumps
    each = max(1, -(-len(shown) // across))
    blocks = Table.grid(padding=(0, BLOCK_GAP, 0, 0))
    starts = range(0, max(1, len(shown)), each)
    blocks.add_row(*(_block(shown[n : n + each], now_s, layout, look.cursor) for n in starts))
    parts: list[RenderableType] = [Text(look.title, style="bold", no_wrap=True), blocks]
    if not rows:
        parts.append(Text("waiting for a vehicle", style="dim italic"))
    if len(shown) < len(rows):
        names = {row.name for row in shown}
        hidden = [row for row in rows if row.name not in names]
        parts.append(Text(f"… {summary(hidden, 'more')}", style="dim italic"))
    if look.keys:
        parts.append(Text(look.keys, style="dim", no_wrap=True))
    parts += [Text(text, style="yellow", no_wrap=True, overflow="ellipsis") for text in warned]
    return Group(*parts)


def _warnings(rows: list[Row], most: int) -> list[str]:
    """Lines on what contradicts an attitude; the last one counts those that have no room."""
    texts = _overload(rows) + [
        f"! vehicle {row.name}: {told(word, row.status)}"
        for row in rows
        if row.status is not None
        for word in row.status.warnings
    ]
    if len(texts) <= most:
        return texts
    return [*texts[: most - 1], f"! and {len(texts) - most + 1} more warnings"]


def told(word: str, status: StatusRecord) -> str:
    """A warning in words; of another attitude, how far it is off and who is likely wrong.

    A warning of another version keeps its own name.
    """
    autopilot = status.autopilot
    if word not in MEANINGS:
        return printable(word, 40)
    if word != Alarm.AUTOPILOT_DIFFERS or autopilot is None:
        return MEANINGS[Alarm(word)]
    who = {"autopilot": "; its own is likely wrong", "ours": "; ours is likely wrong"}
    return printable(f"{autopilot.in_short} ours{who.get(autopilot.wrong, '')}")


def _overload(rows: list[Row]) -> list[str]:
    """A line on what an overloaded service leaves out."""
    statuses = [row.status for row in rows if row.status is not None and row.status.overloaded]
    if not statuses:
        return []
    shed = sum(status.shed for status in statuses)
    slowest_hz = min(status.published_hz for status in statuses)
    return [f"! overloaded: {shed} samples left out so far, attitudes at {slowest_hz:.1f} Hz"]


def _block(rows: list[Row], now_s: float, layout: Layout, cursor: str | None) -> Table:
    view = Table(box=None, header_style="bold", padding=(0, layout.gap, 0, 0), pad_edge=False)
    columns = [name for name in WIDTHS if name not in layout.left_out]
    headings = {"bar": "", "id": "vehicle" if layout is WIDE else "id"}
    for name in columns:
        view.add_column(
            headings.get(name, name),
            justify="left" if name in AT_THE_LEFT else "right",
            no_wrap=True,
            min_width=WIDTHS[name],
        )
    for row in rows:
        cells = _cells(row, now_s)
        style = "reverse" if row.name == cursor else None
        view.add_row(*(cells.get(name, "") for name in columns), style=style)
    return view


def lines(rows: list[Row], now_s: float) -> list[str]:
    """A line a vehicle, or one line for many."""
    if len(rows) > MAX_LINES:
        return [summary(rows, "vehicles")]
    return [_line(row, now_s) for row in rows]


def summary(rows: list[Row], noun: str) -> str:
    """How many there are in which state."""
    counts = {state: sum(row.state is state for row in rows) for state in ATTENTION}
    parts = [f"{count} {state}" for state, count in counts.items() if count]
    return f"{len(rows)} {noun}: {', '.join(parts)}"


def _attention(row: Row) -> int:
    is_warned = row.status is not None and bool(row.status.warnings)
    return 2 * ATTENTION.index(row.state) - is_warned


def _worst_sigma(row: Row) -> float:
    sigma = None if row.attitude is None else row.attitude.sigma_deg
    return 0.0 if sigma is None else -max(sigma.inclination, sigma.heading)


BY_NAME = "name"
ORDERS: dict[str, Callable[[Row], float]] = {"attention": _attention, "sigma": _worst_sigma}


def _line(row: Row, now_s: float) -> str:
    start = f"{row.name:>5}  {state_text(row, now_s):<9}"
    attitude = current_attitude(row, now_s)
    if attitude is None:
        return start
    roll, pitch, yaw = attitude.euler_deg
    sigma = attitude.sigma_deg
    return (
        f"{start} roll {roll:+7.1f}  pitch {pitch:+6.1f} {_sigma(sigma.inclination):<6}"
        f"  heading {_heading(attitude, yaw)} {_sigma(sigma.heading):<6}"
        f"  K {attitude.gain:5.1f}  {_rate(row):>6} Hz  age {age_text(row, now_s)}{_words(row)}"
    )


def _words(row: Row) -> str:
    """The warnings, for the end of a line."""
    words = () if row.status is None else row.status.warnings
    if row.status is not None and row.status.overloaded:
        words = ("overloaded", *words)
    if row.status is not None and row.status.autopilot is not None:
        short = row.status.autopilot.in_short
        words = tuple(short if word == Alarm.AUTOPILOT_DIFFERS else word for word in words)
    return "".join(f"  ! {printable(word, 40)}" for word in words)


def _cells(row: Row, now_s: float) -> dict[str, str | Text]:
    """What stands in the columns; nothing where there is no attitude."""
    imu = (row.status.imu_message if row.status is not None else None) or ""
    attitude = current_attitude(row, now_s)
    return {
        "id": Text(row.name),
        "state": _state_cell(row, now_s),
        **({} if attitude is None else _attitude_cells(attitude)),
        "IMU": Text(imu),
        "IMU Hz": _rate(row),
        "age": age_text(row, now_s),
    }


def _attitude_cells(attitude: AttitudeRecord) -> dict[str, str | Text]:
    roll, pitch, yaw = attitude.euler_deg
    arrow = f" {ARROWS[round(yaw / 45.0) % 8]}" if attitude.heading_reference != "none" else ""
    sigma = attitude.sigma_deg
    judged = trust(State(attitude.state), attitude)
    return {
        "roll": f"{roll:+.1f}°",
        "pitch": f"{pitch:+.1f}°",
        "tilt ±": Text(_sigma(sigma.inclination), style=TRUST_COLOURS[judged.horizon]),
        "heading": f"{_heading(attitude, yaw)}°{arrow}".rjust(WIDTHS["heading"]),
        "head ±": Text(_sigma(sigma.heading), style=TRUST_COLOURS[judged.heading]),
        "gain": f"{attitude.gain:.1f}",
        "bar": _bar(attitude.gain),
    }


def _state_cell(row: Row, now_s: float) -> Text:
    """The state; with a mark and in yellow where something contradicts it, or the autopilot."""
    words = () if row.status is None or is_silent(row, now_s) else row.status.warnings
    if words:
        mark = "≠" if Alarm.AUTOPILOT_DIFFERS in words else "!"
        return Text(f"{state_text(row, now_s)}{mark}", style="bold yellow")
    return Text(state_text(row, now_s), style=COLOURS[row.state])


def _sigma(sigma_deg: float) -> str:
    """The bound that 68 % of the errors lie under."""
    return f"±{sigma_deg:.1f}°" if sigma_deg < 99.95 else f"±{sigma_deg:.0f}°"


def _heading(attitude: AttitudeRecord, yaw_deg: float) -> str:
    """Three digits before the point; in brackets if it refers to nothing."""
    text = f"{yaw_deg % 360:05.1f}"
    text = "000.0" if text == "360.0" else text
    return f"({text})" if attitude.heading_reference == "none" else text


def _bar(gain: float) -> str:
    """The gain as a bar, in eighths of a character."""
    eighths = round(max(0.0, min(1.0, gain / BAR_FULL_GAIN)) * WIDTHS["bar"] * 8)
    full, part = divmod(eighths, 8)
    return ("█" * full + (" ▏▎▍▌▋▊▉"[part] if part else "")).ljust(WIDTHS["bar"])


def _rate(row: Row) -> str:
    return f"{row.status.imu_rate_hz:.1f}" if row.status is not None else "?"
