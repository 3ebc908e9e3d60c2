"""The live view of attitudes: a table on a terminal, with its keys; plain lines elsewhere."""

import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.console import Console, RenderableType
from rich.live import Live

from fuzzbee.horizon import LEAST_HEIGHT, LEAST_WIDTH, screen
from fuzzbee.latest import Latest, Row
from fuzzbee.notify import printable
from fuzzbee.vehicle_table import ORDERS, lines, table
from service.records import Output

if TYPE_CHECKING:
    from fuzzbee.truth_score import TruthScore

REFRESH_HZ = 8
LINE_PERIOD_S = 1.0
MESSAGE_S = 8.0  # so long a message stands at the foot of one vehicle's screen
KEYS = "q quit   s sort by {order}   ↑ ↓ Enter one vehicle"
KEYS_OF_ONE = "q quit   Esc all vehicles   ↑ ↓ the next one"
KEY_NAMES = {"\x1b": "escape", "\r": "enter", "\n": "enter"}
KEY_NAMES |= {"\x1b[A": "up", "\x1bOA": "up", "\x1b[B": "down", "\x1bOB": "down"}
MOST_KEYS = 64  # bytes


class PersonConsole(Console):
    """Output for a person. If nobody reads it any more, everything else goes on.

    ``NO_COLOR`` in the environment means no style at all: bold is drawn as a colour by many.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(color_system=None if os.environ.get("NO_COLOR") else "auto", **options)

    def on_broken_pipe(self) -> None:
        """Print no more; rich would close standard output, even if another broke, and exit."""
        self.quiet = True


class TerminalView:
    """Shows what it is given; a sink of the service, and watch's display.

    On a terminal a table is redrawn in place, or ``one`` vehicle as an artificial horizon.
    Elsewhere there is a line a vehicle and second, so that a log of it can be read.
    """

    name = "terminal"
    rest_s = 0.5 / REFRESH_HZ

    def __init__(
        self,
        console: Console,
        messages: Console,
        title: str,
        now_s: Callable[[], float] = time.monotonic,
        one: str | None = None,
    ) -> None:
        self.model = Latest()
        self.title = title
        self.one = self.cursor = one  # the vehicle that is shown alone, that Enter shows alone
        self.order = next(iter(ORDERS))
        self.is_closed = False  # by a key
        self.scores: dict[str, TruthScore] | None = None  # by the vehicle's name
        self._console = console
        self._messages = messages
        self._now_s = now_s
        self._keys = ""  # what the keys do, if there are any
        self._next_line_s = 0.0
        self._message, self._message_s = "", -MESSAGE_S
        self._drawn = (console.size, False)  # the size, and whether one vehicle fills it
        is_live = console.is_terminal and not console.is_dumb_terminal
        self._live = self._start() if is_live else None

    @property
    def is_live(self) -> bool:
        """Whether a table is redrawn in place."""
        return self._live is not None

    def handle(self, outputs: Sequence[Output]) -> None:
        """Show outputs of the service."""
        self.notify(*self.model.take(outputs, self._now_s()))
        self.refresh()

    def notify(self, *texts: str) -> None:
        """Lines for a person, above the table; on one vehicle's screen the last at its foot."""
        if not texts:
            return
        shown = [*map(printable, texts)]  # written at one go: vehicles that begin send several each
        self._message, self._message_s = shown[-1], self._now_s()
        if self._live is None:
            _print(self._messages, shown, style="dim")
        elif not self._drawn[1]:  # at the foot it would be left above
            _print(self._live.console, shown, style="dim")

    def refresh(self) -> None:
        """Print plain lines when they are due; the table redraws itself.

        What it cannot draw over is cleared: after resizing the terminal has broken it up, and one
        vehicle needs the lines above the table.
        """
        now_s = self._now_s()
        if self._live is not None:
            seen = (self._console.size, self._alone() is not None)
            if seen != self._drawn:
                self._live.stop()
                self._drawn = seen
                self._console.clear()
                self._live = self._start()
        elif now_s >= self._next_line_s and (rows := self._rows(self.one)):
            self._next_line_s = now_s + LINE_PERIOD_S
            truth = self._truth(rows)
            _print(self._console, (f"{text}  {truth}".rstrip() for text in lines(rows)))

    def press(self, keys: Iterable[str]) -> None:
        """Quit, sort, choose a vehicle, show it alone or all again."""
        for key in keys:
            names = [row.name for row in self._rows()]
            match key:
                case "q":
                    self.is_closed = True
                case "s":
                    self.order = _after(self.order, [*ORDERS])
                case "up" | "k" | "down" | "j" if names:
                    self.cursor = _after(self.cursor, names[::-1] if key in ("up", "k") else names)
                    self.one = self.one and self.cursor
                case "enter" if names:
                    self.one = self.cursor = self.cursor or names[0]
                case "escape" | "a":
                    self.one = self.cursor = None
        next_order = _after(self.order, [*ORDERS])
        self._keys = KEYS_OF_ONE if self.one else KEYS.format(order=next_order)

    def close(self) -> None:
        """Leave the last table standing."""
        if self._live is not None:
            self._live.stop()

    def _rows(self, one: str | None = None) -> list[Row]:
        """All rows in the order chosen, or that of one vehicle."""
        rows = [row for row in self.model.rows(self._now_s()) if one in (None, row.name)]
        return sorted(rows, key=ORDERS[self.order])

    def _start(self) -> Live:
        live = Live(
            get_renderable=self._table, console=self._console, refresh_per_second=REFRESH_HZ
        )
        live.start()
        return live

    def _alone(self) -> Row | None:
        """The vehicle that fills the screen, if it is there and has room."""
        width, height = self._console.size
        if self.one is None or width < LEAST_WIDTH or height < LEAST_HEIGHT:
            return None
        return next(iter(self._rows(self.one)), None)

    def _table(self) -> RenderableType:
        width, height = self._console.size
        alone = self._alone()
        if alone is not None:
            is_recent = self._now_s() - self._message_s < MESSAGE_S
            foot = self._message if is_recent else self._keys
            return screen(alone, width, height - 1, self._console, foot)
        rows = self._rows(self.one)
        keys = self._truth(rows) or self._keys
        return table(rows, width, height, self.title, keys, self.cursor)

    def _truth(self, rows: list[Row]) -> str:
        """How far off the only vehicle is that is shown, if a simulator shows."""
        score = (self.scores or {}).get(rows[0].name) if len(rows) == 1 else None
        return "" if score is None else score.line


def _print(console: Console, texts: Iterable[str], style: str | None = None) -> None:
    """Print lines as they are; a broken stream must not stop the other one."""
    with suppress(OSError):
        console.print("\n".join(texts), style=style, markup=False, highlight=False, soft_wrap=True)


def _after(current: str | None, names: list[str]) -> str:
    """The name after the current one, in a ring; the first if there is none."""
    return names[(names.index(current) + 1) % len(names)] if current in names else names[0]


def pressed_keys(descriptor: int) -> list[str]:
    """Letters, and ``up``, ``down``, ``enter``, ``escape``, since the last call; never waits."""
    try:
        is_there = select.select([descriptor], [], [], 0.0)[0]
        text = os.read(descriptor, MOST_KEYS).decode("ascii", "ignore") if is_there else ""
    except (OSError, ValueError):  # the terminal is gone
        return []
    return [KEY_NAMES.get(key, key) for key in re.findall(r"\x1b[\[O][AB]|.", text, re.DOTALL)]


@contextmanager
def terminal_keys() -> Iterator[Callable[[], list[str]]]:
    """What gives the keys of standard input, none where that is no terminal of ours."""
    try:
        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        is_ours = os.tcgetpgrp(descriptor) == os.getpgrp()  # in the background we would be stopped
    except (AttributeError, OSError, ValueError, termios.error):  # closed, or no terminal
        is_ours = False
    if not is_ours:
        yield list
        return
    try:
        tty.setcbreak(descriptor, termios.TCSANOW)  # Ctrl-C stays what it is
        yield partial(pressed_keys, descriptor)
    finally:
        with suppress(termios.error, OSError):
            termios.tcsetattr(descriptor, termios.TCSANOW, before)
