"""What ``watch`` shows: lines of JSON, or the live table."""

import os
import sys
import time

import msgspec

from fuzzbee.reception import Reception, Record
from fuzzbee.say import say
from fuzzbee.terminal import PersonConsole, TerminalView
from fuzzbee.vehicle_table import BY_NAME, ORDERS
from fuzzbee.web.server import WebPage, open_page
from service.records import AttitudeRecord

KEYS = "q quit   s sort by {order}   ↑ ↓ Enter one vehicle"
KEYS_OF_ONE = "q quit   Esc all vehicles   ↑ ↓ the next one"


class Display:
    """What records are shown on; without keys, and with nothing to redraw or to close."""

    closed = False
    shows_others = False  # whether a key leads from one vehicle to all

    def __init__(self) -> None:
        self._reception = Reception(self.say)

    def show(self, key: str, payload: bytes) -> int:
        """Take one record; 1 if it was an attitude that counts."""
        received = self._reception.record(key, payload)
        return 0 if received is None else int(self._take(*received))

    def _take(self, name: str, record: Record) -> bool:
        raise NotImplementedError

    def say(self, text: str) -> None:
        """One line for a person."""
        say(text)

    def press(self, keys: list[str]) -> None:
        """Do what the keys mean."""

    def refresh(self) -> None:
        """Show what is due."""

    def close(self) -> None:
        """Show no more."""


class JsonLines(Display):
    """Attitudes as JSON, one a line, with the vehicle's name first."""

    def _take(self, name: str, record: Record) -> bool:
        line = msgspec.json.encode({"vehicle": name, **msgspec.structs.asdict(record)})
        try:
            print(line.decode(), flush=True)
        except BrokenPipeError:  # the reader is gone, which is no error
            self.closed = True
            # nothing is left to fail at a flush
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return False
        return True


class Table(Display):
    """Attitudes and statuses as the live table, or as plain lines."""

    def __init__(
        self, prefix: str, vehicle: str | None = None, view: TerminalView | None = None
    ) -> None:
        super().__init__()
        self._title = title = f"fuzzbee watch {prefix}/*"
        self._view = view or TerminalView(PersonConsole(), PersonConsole(stderr=True), title)
        self._view.one = self._view.cursor = self._vehicle = vehicle
        self.shows_others = self._view.is_live

    def web_page(self, address: str) -> WebPage:
        """The same for browsers."""
        return open_page(address, self._title, self._view.model)

    def say(self, text: str) -> None:
        """One line for a person, above the table."""
        self._view.say(text)

    def refresh(self) -> None:
        """Print the lines that are due."""
        self._view.refresh()

    def close(self) -> None:
        """Leave the last table standing."""
        self._view.close()

    def _take(self, name: str, record: Record) -> bool:
        self._view.model.update(name, record, time.monotonic())
        return isinstance(record, AttitudeRecord) and self._vehicle in (None, name)

    def press(self, keys: list[str]) -> None:
        """Quit, sort, choose a vehicle, show it alone or all again."""
        view = self._view
        for key in keys:
            names = [row.name for row in view.rows()]
            match key:
                case "q":
                    self.closed = True
                case "s":
                    view.order = _after(view.order, [BY_NAME, *ORDERS])
                case "up" | "k" if names:
                    self._choose(_after(view.cursor, names[::-1]))
                case "down" | "j" if names:
                    self._choose(_after(view.cursor, names))
                case "enter" if names:
                    view.one = view.cursor = view.cursor or names[0]
                case "escape" | "a":
                    view.one = view.cursor = None
        if view.is_live:
            following = _after(view.order, [BY_NAME, *ORDERS])
            view.keys = KEYS.format(order=following) if view.one is None else KEYS_OF_ONE

    def _choose(self, name: str) -> None:
        self._view.cursor = name
        if self._view.one is not None:
            self._view.one = name


def _after(current: str | None, names: list[str]) -> str:
    """The name after the current one, in a ring; the first if there is none."""
    return names[(names.index(current) + 1) % len(names)] if current in names else names[0]
