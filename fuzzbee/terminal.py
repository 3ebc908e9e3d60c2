"""The live view of attitudes: a table on a terminal, plain lines elsewhere."""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group, RenderableType

from fuzzbee.horizon import Ink, has_room, screen
from fuzzbee.say import printable
from fuzzbee.table_model import Row, TableModel
from fuzzbee.vehicle_table import BY_NAME, ORDERS, Look, lines, table
from service.records import Output

if TYPE_CHECKING:
    from rich.live import Live

    from fuzzbee.truth_score import TruthScore

REFRESH_HZ = 8
LINE_PERIOD_S = 1.0
MESSAGE_S = 8.0  # so long a message stands at the foot of one vehicle's screen
COLOURS_OF = {None: 0, "standard": 16, "windows": 16}


class PersonConsole(Console):
    """Output for a person. If nobody reads it any more, everything else goes on.

    ``NO_COLOR`` in the environment means no style at all: bold is drawn as a colour by many.
    """

    def __init__(self, **options: Any) -> None:
        colours = {"color_system": None} if os.environ.get("NO_COLOR") else {}
        super().__init__(**{**options, **colours})

    def on_broken_pipe(self) -> None:
        """Print no more; rich would close standard output, even if another broke, and exit."""
        self.quiet = True


class TerminalView:
    """Shows what it is given; a sink of the service, and watch's display.

    On a terminal a table is redrawn in place. Elsewhere there is a line a
    vehicle and second, so that a log of it can be read.
    """

    name = "terminal"
    rest_s = 0.5 / REFRESH_HZ

    def __init__(
        self,
        console: Console,
        messages: Console,
        title: str,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.model = TableModel()
        self.order = BY_NAME
        self.one: str | None = None  # the vehicle that is shown alone
        self.cursor: str | None = None  # the vehicle that Enter shows alone
        self.keys = ""  # what the keys do, if there are any
        self.scores: dict[str, TruthScore] | None = None  # by the vehicle's name
        self._console = console
        self._messages = messages
        self._title = title
        self._now_s = now_s
        self._next_line_s = 0.0
        self._said, self._said_s = "", -MESSAGE_S
        self._drawn = (console.size, False)  # the size, and whether one vehicle fills it
        is_live = console.is_terminal and not console.is_dumb_terminal
        self._live = self._start() if is_live else None

    def handle(self, outputs: Sequence[Output]) -> None:
        """Show outputs of the service."""
        self.say(*self.model.take(outputs, self._now_s()))
        self.refresh()

    def say(self, *texts: str) -> None:
        """Lines for a person, above the table; on the screen of one vehicle the last at its foot.

        All are written at one go: hundreds of vehicles that begin say several each.
        """
        if not texts:
            return
        said = [*map(printable, texts)]
        self._said, self._said_s = said[-1], self._now_s()
        if self._live is not None and self._drawn[1]:
            return  # it stands at the foot, and would be left above
        target = self._messages if self._live is None else self._live.console
        with suppress(OSError):  # a broken stream must not stop the other one
            target.print(
                "\n".join(said), style="dim", markup=False, highlight=False, soft_wrap=True
            )

    def refresh(self) -> None:
        """Print plain lines when they are due; the table redraws itself."""
        now_s = self._now_s()
        if self._live is not None:
            self._start_anew_if_needed()
            return
        if now_s < self._next_line_s:
            return
        rows = [row for row in self.model.rows() if self.one in (None, row.name)]
        if rows:
            self._next_line_s = now_s + LINE_PERIOD_S
            truth = self._truth(rows)
            for text in lines(rows, now_s):
                self._console.print(
                    f"{text}  {truth}".rstrip(), markup=False, highlight=False, soft_wrap=True
                )

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

    def _start_anew_if_needed(self) -> None:
        """Clear what cannot be drawn over.

        After resizing the terminal has broken it up; one vehicle needs the lines above the table.
        """
        now = (self._console.size, self._alone() is not None)
        if self._live is not None and now != self._drawn:
            self._live.stop()
            self._drawn = now
            self._console.clear()
            self._live = self._start()

    def _alone(self) -> Row | None:
        """The vehicle that fills the screen, if it is there and has room."""
        size = self._console.size
        if self.one is None or not has_room(size.width, size.height):
            return None
        return next((row for row in self.rows() if row.name == self.one), None)

    def _table(self) -> RenderableType:
        size = self._console.size
        alone = self._alone()
        if alone is not None:
            is_said = self._now_s() - self._said_s < MESSAGE_S
            foot = self._said if is_said else self.keys
            width, height = size.width, size.height - 1
            return one_vehicle(alone, self._now_s(), width, height, self._console, foot)
        rows = [row for row in self.rows() if self.one in (None, row.name)]
        foot = self._truth(rows) or self.keys
        look = Look(self._title, foot, self.cursor)
        return table(rows, self._now_s(), size.width, size.height, look)

    def _truth(self, rows: list[Row]) -> str:
        """How far off the only vehicle is that is shown, if a simulator tells."""
        score = (self.scores or {}).get(rows[0].name) if len(rows) == 1 else None
        return "" if score is None else score.line

    @property
    def is_live(self) -> bool:
        """Whether a table is redrawn in place."""
        return self._live is not None

    def rows(self) -> list[Row]:
        """All rows in the order chosen."""
        rows = self.model.rows()
        return rows if self.order == BY_NAME else sorted(rows, key=ORDERS[self.order])


def one_vehicle(
    row: Row, now_s: float, width: int, height: int, console: Console, foot: str
) -> RenderableType:
    """One vehicle as an artificial horizon, in the characters and colours of the console."""
    colours = COLOURS_OF.get(console.color_system, 256)
    ink = Ink(colours, console.encoding.startswith("utf"))
    return Group(*screen(row, now_s, width, height, ink, foot))
