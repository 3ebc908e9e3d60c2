"""``fuzzbee watch``: subscribe and show attitudes."""

import os
import re
import sys
import time
from collections import deque
from contextlib import ExitStack, nullcontext
from threading import Condition, Event
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.errors import InputError
from fuzzbee import zenoh_options
from fuzzbee.options import Seconds, Verbose, require_positive
from fuzzbee.say import say

if TYPE_CHECKING:
    import zenoh

    from fuzzbee.keys import Keys
    from fuzzbee.terminal import TerminalView
    from service.zenoh_session import ZenohOptions

EPILOG = """Examples:

  fuzzbee watch

  fuzzbee watch 1

  fuzzbee watch --json -n 100 > attitudes.jsonl

  fuzzbee watch -m client -e tcp/192.168.1.10:7447"""

VEHICLE = re.compile(r"[0-9]{1,3}(-[0-9]{1,3})?")
HINT_AFTER_S = 3.0
WAIT_S = 0.1
# 2 s of 50 vehicles at 100 Hz. When it is full the oldest is dropped: the newest is worth most.
MAX_PENDING = 10_000
MOST_BYTES = 100_000

KEYS = "q quit   s sort by {order}   ↑ ↓ Enter one vehicle"
KEYS_OF_ONE = "q quit   Esc all vehicles   ↑ ↓ the next one"
NOBODY = ": is fuzzbee run started, with a vehicle and the same Zenoh options?"
FAILED = 1


def watch(
    vehicle: Annotated[
        str | None,
        typer.Argument(
            help="Only this vehicle (system id, or S-C): on a terminal an artificial horizon.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object a line, for each attitude.")
    ] = False,
    count: Annotated[
        int | None, typer.Option("--count", "-n", metavar="N", help="End after N attitudes.")
    ] = None,
    seconds: Seconds = None,
    listen: zenoh_options.Listen = None,
    connect: zenoh_options.Connect = None,
    mode: zenoh_options.Mode = "peer",
    config_file: zenoh_options.ConfigFile = None,
    settings: zenoh_options.Settings = None,
    multicast: zenoh_options.Multicast = False,
    prefix: zenoh_options.Prefix = "fuzzbee",
    verbose: Verbose = False,  # noqa: ARG001 - read by the command line itself
) -> int:
    """Show the attitudes that a running service publishes.

    On a terminal q quits, s sorts, the arrows choose a vehicle and Enter shows it alone.
    """
    require_positive("--seconds", seconds)
    if count is not None and count < 1:
        raise InputError(f"--count {count}: should be at least 1")
    if vehicle is not None and not VEHICLE.fullmatch(vehicle):
        raise InputError(f"{vehicle}: should be a vehicle, such as 1 or 1-154")
    options = zenoh_options.zenoh_options(
        listen=listen,
        connect=connect,
        mode=mode,
        config_file=config_file,
        settings=settings,
        multicast=multicast,
        prefix=prefix,
    )
    return follow(options, vehicle, as_json=as_json, count=count, seconds=seconds)


class Inbox:
    """Samples between zenoh's thread and ours, bounded; the oldest go first."""

    def __init__(self) -> None:
        self._samples: deque[tuple[str, bytes]] = deque(maxlen=MAX_PENDING)
        self._changed = Condition()

    def put(self, sample: "zenoh.Sample") -> None:
        """Take one; called by zenoh."""
        with self._changed:
            if len(sample.payload) <= MOST_BYTES:  # anything longer is no record of ours
                self._samples.append((str(sample.key_expr), sample.payload.to_bytes()))
                self._changed.notify()

    def drain(self, timeout_s: float) -> list[tuple[str, bytes]]:
        """Keys and payloads that wait, after waiting at most ``timeout_s`` for the first."""
        with self._changed:
            if not self._samples:
                self._changed.wait(timeout_s)
            samples = list(self._samples)
            self._samples.clear()
        return samples


def follow(
    options: "ZenohOptions",
    vehicle: str | None,
    *,
    as_json: bool,
    count: int | None,
    seconds: float | None,
) -> int:
    """Show what comes until stopped; 1 if a bounded watch got less than was asked for.

    Raises:
        InputError: a Zenoh option that cannot be used.
    """
    from fuzzbee.keys import terminal_keys
    from service.signals import stop_on_signals
    from service.zenoh_session import close_session, open_session

    inbox = Inbox()
    stop = Event()
    with ExitStack() as stack:
        session = open_session(options)
        stack.callback(close_session, session)
        stack.enter_context(stop_on_signals(stop.set))
        display = JsonLines() if as_json else Table(options.prefix, vehicle)
        # a person may go back from one vehicle to all
        name = "*" if vehicle is None or display.shows_others else vehicle
        session.declare_subscriber(f"{options.prefix}/{name}/attitude", inbox.put)
        if not as_json:
            session.declare_subscriber(f"{options.prefix}/{name}/status", inbox.put)
        with nullcontext() if as_json else terminal_keys() as keys:
            try:
                seen = _loop(inbox, stop, display, _hint(options, vehicle), count, seconds, keys)
            finally:
                display.close()
    if display.closed or stop.is_set():
        return 0
    if seen >= (count or 1):
        return 0
    said = f"{seen} attitudes" if seen else "no attitude"
    key = f"{options.prefix}/{vehicle or '*'}/attitude"
    say(f"{said} on {key} in {seconds:g} s{'' if seen else NOBODY}")
    return FAILED


def _loop(
    inbox: Inbox,
    stop: Event,
    display: "JsonLines | Table",
    hint: str,
    count: int | None,
    seconds: float | None,
    keys: "Keys | None",
) -> int:
    """Show what comes until the end; returns the number of attitudes."""
    started_s = time.monotonic()
    hint_s: float | None = started_s + HINT_AFTER_S
    seen = 0
    while not stop.is_set():
        for key, payload in inbox.drain(WAIT_S):
            hint_s = None
            if count is not None and seen >= count:
                break
            seen += display.show(key, payload)
        if keys is not None:
            display.press(keys.pressed())
        display.refresh()
        now_s = time.monotonic()
        if (count is not None and seen >= count) or display.closed:
            break
        if seconds is not None and now_s - started_s >= seconds:
            break
        if hint_s is not None and now_s >= hint_s:
            hint_s = None
            display.say(hint)
    return seen


def _after(current: str | None, names: list[str]) -> str:
    """The name after the current one, in a ring; the first if there is none."""
    return names[(names.index(current) + 1) % len(names)] if current in names else names[0]


def _hint(options: "ZenohOptions", vehicle: str | None) -> str:
    key = f"{options.prefix}/{vehicle or '*'}/attitude"
    return f"nothing on {key} yet{NOBODY} (waiting; Ctrl-C ends)"


class JsonLines:
    """Attitudes as JSON, one a line, with the vehicle's name first."""

    closed = False
    shows_others = False

    def __init__(self) -> None:
        from fuzzbee.reception import Reception

        self._reception = Reception(self.say)

    def show(self, key: str, payload: bytes) -> int:
        """Print one attitude; 1 if it was one."""
        import msgspec

        received = self._reception.record(key, payload)
        if received is None:
            return 0
        name, record = received
        line = msgspec.json.encode({"vehicle": name, **msgspec.structs.asdict(record)})
        try:
            print(line.decode(), flush=True)
        except BrokenPipeError:
            self._leave()
            return 0
        return 1

    def say(self, text: str) -> None:
        """One line for a person."""
        say(text)

    def press(self, keys: list[str]) -> None:
        """Do nothing: there are none."""

    def refresh(self) -> None:
        """Do nothing: each line is printed at once."""

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def _leave(self) -> None:
        """End because the reader is gone, which is no error. Nothing is left to fail at a flush."""
        self.closed = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Table:
    """Attitudes and statuses as the live table, or as plain lines."""

    closed = False

    def __init__(
        self, prefix: str, vehicle: str | None = None, view: "TerminalView | None" = None
    ) -> None:
        from fuzzbee.reception import Reception
        from fuzzbee.terminal import PersonConsole, TerminalView
        from fuzzbee.vehicle_table import BY_NAME, ORDERS

        self._orders = [BY_NAME, *ORDERS]
        title = f"fuzzbee watch {prefix}/*"
        self._view = view or TerminalView(PersonConsole(), PersonConsole(stderr=True), title)
        self._view.one = self._view.cursor = self._vehicle = vehicle
        self._reception = Reception(self.say)

    @property
    def shows_others(self) -> bool:
        """Whether a key leads from one vehicle to all."""
        return self._view.is_live

    def show(self, key: str, payload: bytes) -> int:
        """Take one record; 1 if it was an attitude."""
        received = self._reception.record(key, payload)
        if received is None:
            return 0
        name, record = received
        self._view.board.update(name, record, time.monotonic())
        return int(key.endswith("/attitude") and self._vehicle in (None, name))

    def say(self, text: str) -> None:
        """One line for a person."""
        self._view.say(text)

    def press(self, keys: list[str]) -> None:
        """Quit, sort, choose a vehicle, show it alone or all again."""
        view = self._view
        for key in keys:
            names = [row.name for row in view.rows()]
            match key:
                case "q":
                    self.closed = True
                case "s":
                    view.order = _after(view.order, self._orders)
                case "up" | "k" if names:
                    self._choose(_after(view.cursor, names[::-1]))
                case "down" | "j" if names:
                    self._choose(_after(view.cursor, names))
                case "enter" if names:
                    view.one = view.cursor = view.cursor or names[0]
                case "escape" | "a":
                    view.one = view.cursor = None
        if view.is_live:
            following = _after(view.order, self._orders)
            view.keys = KEYS.format(order=following) if view.one is None else KEYS_OF_ONE

    def _choose(self, name: str) -> None:
        self._view.cursor = name
        if self._view.one is not None:
            self._view.one = name

    def refresh(self) -> None:
        """Print the lines that are due."""
        self._view.refresh()

    def close(self) -> None:
        """Leave the last table standing."""
        self._view.close()
