"""The live view of attitudes: a table on a terminal, plain lines elsewhere."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.health import State
from service.records import AttitudeRecord, Message, Output, Published, StatusRecord, vehicle_name

if TYPE_CHECKING:
    from rich.live import Live

REFRESH_HZ = 8
LINE_PERIOD_S = 1.0
MAX_LINES = 8  # more vehicles than this share one line
SILENT_AFTER_S = 3.0  # a status comes every second
WIDE = 100  # columns, from which on there is room for everything
FRAME_LINES = 4  # title, header and the two lines below

COLOURS = {
    State.WAITING: "dim",
    State.ALIGNING: "cyan",
    State.RUNNING: "green",
    State.DEGRADED: "yellow",
    State.LOST: "red",
}
ATTENTION = (State.LOST, State.DEGRADED, State.WAITING, State.ALIGNING, State.RUNNING)
ARROWS = "↑↗→↘↓↙←↖"  # the heading, north up
BAR_FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100
BAR_WIDTH = 8


class Row(NamedTuple):
    """The latest of one vehicle; ``heard_s`` is when (monotonic)."""

    name: str
    attitude: AttitudeRecord | None
    status: StatusRecord | None
    attitude_s: float
    heard_s: float

    @property
    def state(self) -> State:
        """The state that was published last."""
        if self.attitude is not None and self.attitude_s >= self.heard_s:
            return State(self.attitude.state)
        return State(self.status.state) if self.status is not None else State.WAITING


class Board:
    """The latest records of all vehicles; written by one thread, read by another."""

    def __init__(self) -> None:
        self._rows: dict[str, Row] = {}
        self._lock = threading.Lock()

    def update(self, name: str, record: AttitudeRecord | StatusRecord, now_s: float) -> None:
        """Remember a record."""
        with self._lock:
            row = self._rows.get(name, Row(name, None, None, 0.0, 0.0))
            if isinstance(record, AttitudeRecord):
                row = row._replace(attitude=record, attitude_s=now_s)
            else:
                row = row._replace(status=record)
            self._rows[name] = row._replace(heard_s=now_s)

    def rows(self) -> list[Row]:
        """All rows by name, numbers in their order."""
        with self._lock:
            rows = list(self._rows.values())
        return sorted(rows, key=lambda row: [int(part) for part in row.name.split("-")])


class TerminalView:
    """Shows what it is given; a sink of the service, and watch's display.

    On a terminal a table is redrawn in place. Elsewhere there is a line a
    vehicle and second, so that a log of it can be read.
    """

    name = "terminal"

    def __init__(
        self,
        console: Console,
        messages: Console,
        title: str,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.board = Board()
        self._console = console
        self._messages = messages
        self._title = title
        self._now_s = now_s
        self._next_line_s = 0.0
        self._live = self._start() if console.is_terminal else None

    def handle(self, outputs: Sequence[Output]) -> None:
        """Show outputs of the service."""
        for output in outputs:
            match output:
                case Message(text=text):
                    self.say(text)
                case Published(vehicle=vehicle, record=record):
                    self.board.update(vehicle_name(vehicle), record, self._now_s())
        self.refresh()

    def say(self, text: str) -> None:
        """One line for a person, above the table."""
        target = self._messages if self._live is None else self._live.console
        target.print(text, style="dim", markup=False, highlight=False, soft_wrap=True)

    def refresh(self) -> None:
        """Plain lines, when they are due; the table redraws itself."""
        now_s = self._now_s()
        if self._live is not None or now_s < self._next_line_s:
            return
        rows = self.board.rows()
        if rows:
            self._next_line_s = now_s + LINE_PERIOD_S
            for text in lines(rows, now_s):
                self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """Leave the last table standing."""
        if self._live is not None:
            self._live.stop()

    def _start(self) -> "Live":
        from rich.live import Live

        live = Live(
            get_renderable=self._table,
            console=self._console,
            refresh_per_second=REFRESH_HZ,
            transient=False,
        )
        live.start()
        return live

    def _table(self) -> Table:
        size = self._console.size
        return table(self.board.rows(), self._now_s(), size.width, size.height, self._title)


def table(rows: list[Row], now_s: float, width: int, height: int, title: str) -> Table:
    """The rows that fit into ``height`` lines; those that need attention first if not all do."""
    wide = width >= WIDE
    view = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=None,
        header_style="bold",
        padding=(0, 2, 0, 0),
        caption_justify="left",
    )
    for name in ("vehicle", "state"):
        view.add_column(name, no_wrap=True)
    for name in ("roll", "pitch", "heading", "error", "gain"):
        view.add_column(name, justify="right", no_wrap=True)
    if wide:
        view.add_column("", no_wrap=True, min_width=BAR_WIDTH)
        view.add_column("IMU", no_wrap=True)
    for name in ("IMU Hz", "age"):
        view.add_column(name, justify="right", no_wrap=True)
    room = max(1, height - FRAME_LINES - 1)
    shown = rows if len(rows) <= room else sorted(rows, key=_attention)[: room - 1]
    for row in shown:
        view.add_row(*_cells(row, now_s, wide=wide))
    if not rows:
        view.caption = "waiting for a vehicle"
    if len(shown) < len(rows):
        names = {row.name for row in shown}
        view.caption = "… " + summary([row for row in rows if row.name not in names], "more")
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
    return ATTENTION.index(row.state)


def _line(row: Row, now_s: float) -> str:
    start = f"{row.name:>5}  {_state_text(row, now_s):<9}"
    attitude = _current(row)
    if attitude is None:
        return start
    roll, pitch, yaw = attitude.euler_deg
    return (
        f"{start} roll {roll:+7.1f}  pitch {pitch:+6.1f}  heading {_heading(attitude, yaw)}"
        f"  error {attitude.error:.4f}  K {attitude.gain:5.1f}  {_rate(row):>6} Hz"
        f"  age {_age_text(row, now_s)}"
    )


def _cells(row: Row, now_s: float, *, wide: bool) -> list[str | Text]:
    state = Text(_state_text(row, now_s), style=COLOURS[row.state])
    attitude = _current(row)
    imu = (row.status.imu_message if row.status is not None else None) or ""
    extra = ["", imu] if wide else []
    if attitude is None:
        return [row.name, state, "", "", "", "", "", *extra, _rate(row), ""]
    roll, pitch, yaw = attitude.euler_deg
    arrow = ARROWS[round(yaw / 45.0) % 8] if attitude.heading_reference != "none" else " "
    if wide:
        extra[0] = _bar(attitude.gain)
    return [
        row.name,
        state,
        f"{roll:+.1f}°",
        f"{pitch:+.1f}°",
        f"{_heading(attitude, yaw)}° {arrow}",
        f"{attitude.error:.4f}",
        f"{attitude.gain:.1f}",
        *extra,
        _rate(row),
        _age_text(row, now_s),
    ]


def _current(row: Row) -> AttitudeRecord | None:
    """The attitude, unless the vehicle has none to give any more."""
    return row.attitude if row.state in (State.RUNNING, State.DEGRADED) else None


def _state_text(row: Row, now_s: float) -> str:
    return "silent" if now_s - row.heard_s > SILENT_AFTER_S else row.state.value


def _heading(attitude: AttitudeRecord, yaw_deg: float) -> str:
    """Three digits before the point; in brackets if it refers to nothing."""
    text = f"{yaw_deg % 360:05.1f}"
    text = "000.0" if text == "360.0" else text
    return f"({text})" if attitude.heading_reference == "none" else text


def _bar(gain: float) -> str:
    """The gain as a bar, in eighths of a character."""
    eighths = round(max(0.0, min(1.0, gain / BAR_FULL_GAIN)) * BAR_WIDTH * 8)
    full, part = divmod(eighths, 8)
    return ("█" * full + (" ▏▎▍▌▋▊▉"[part] if part else "")).ljust(BAR_WIDTH)


def _rate(row: Row) -> str:
    return f"{row.status.imu_rate_hz:.1f}" if row.status is not None else "?"


def _age_text(row: Row, now_s: float) -> str:
    assert row.attitude is not None
    age_ms = row.attitude.age_ms + 1e3 * max(0.0, now_s - row.attitude_s)
    return f"{age_ms:.0f} ms" if age_ms < 1000.0 else f"{age_ms / 1e3:.1f} s"
