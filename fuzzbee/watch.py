"""``fuzzbee watch``: subscribe and show attitudes."""

import time
from collections import deque
from contextlib import ExitStack, closing, nullcontext
from math import inf
from threading import Condition, Event
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee.options import Seconds, Verbose, command, examples, option, require_positive
from fuzzbee.say import say
from fuzzbee.sinks import WEB
from fuzzbee.zenoh_options import ZenohArguments, opened

if TYPE_CHECKING:
    import zenoh

    from fuzzbee.displays import Display
    from fuzzbee.keys import Keys

EPILOG = examples(
    "fuzzbee watch",
    "fuzzbee watch 1",
    "fuzzbee watch --json -n 100 > attitudes.jsonl",
    "fuzzbee watch -m client -e tcp/192.168.1.10:7447",
)

HINT_AFTER_S = 3.0
WAIT_S = 0.1
# 2 s of 50 vehicles at 100 Hz. When it is full the oldest is dropped: the newest is worth most.
MAX_PENDING = 10_000
MOST_BYTES = 100_000

NOBODY = ": is fuzzbee run started, with the same Zenoh options?"
FAILED = 1
_VEHICLE = "Only this vehicle (system id, or S-C): on a terminal an artificial horizon."


class WatchOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    vehicle: Annotated[str | None, typer.Argument(help=_VEHICLE, show_default=False)] = None
    as_json: Annotated[bool, option("One JSON object a line, for each attitude.", "--json")] = False
    most: Annotated[int | None, option("End after N attitudes.", "--count", "-n", metavar="N")] = (
        None
    )
    seconds: Seconds = None
    web: Annotated[str | None, option(WEB, metavar="[ADDRESS:]PORT")] = None
    zenoh: ZenohArguments = ZenohArguments()
    verbose: Verbose = False  # read by the command line itself


@command
def watch(options: WatchOptions) -> int:
    """Show what a running service publishes.

    On a terminal q quits, s sorts, the arrows choose a vehicle and Enter shows it alone.
    """
    from fuzzbee.reception import VEHICLE

    require_positive("--seconds", options.seconds)
    if options.most is not None and options.most < 1:
        raise InputError(f"--count {options.most}: should be at least 1")
    if options.web is not None and options.as_json:
        raise InputError("--web: not with --json, which shows nothing")
    if options.vehicle is not None and not (
        VEHICLE.fullmatch(options.vehicle)
        and all(1 <= int(number) <= 255 for number in options.vehicle.split("-"))
    ):
        raise InputError(f"{options.vehicle}: should be a vehicle, such as 1 or 1-154")
    return follow(options)


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


def follow(options: WatchOptions) -> int:
    """Show what comes until stopped; 1 if a bounded watch got less than was asked for.

    Raises:
        InputError: a Zenoh option that cannot be used.
    """
    from fuzzbee.displays import JsonLines, Table
    from fuzzbee.keys import terminal_keys
    from service.signals import stop_on_signals
    from service.zenoh_session import OpeningSession

    inbox = Inbox()
    stop = Event()
    prefix, vehicle = options.zenoh.prefix, options.vehicle
    with ExitStack() as stack:
        session = opened(OpeningSession(options.zenoh.options()), stack)
        stack.enter_context(stop_on_signals(stop.set))
        display = JsonLines() if options.as_json else Table(prefix, vehicle)
        if options.web is not None and isinstance(display, Table):
            stack.enter_context(closing(display.web_page(options.web)))
        # a person may go back from one vehicle to all
        name = "*" if vehicle is None or display.shows_others else vehicle
        session.declare_subscriber(f"{prefix}/{name}/attitude", inbox.put)
        if not options.as_json:
            session.declare_subscriber(f"{prefix}/{name}/status", inbox.put)
        with nullcontext() if options.as_json else terminal_keys() as keys:
            try:
                seen = _loop(inbox, stop, display, options, keys)
            finally:
                display.close()
    if display.closed or stop.is_set() or seen >= (options.most or 1):
        return 0
    said = f"{seen} attitudes" if seen else "no attitude"
    say(f"{said} on {_key(options)} in {options.seconds:g} s{'' if seen else NOBODY}")
    return FAILED


def _loop(
    inbox: Inbox,
    stop: Event,
    display: "Display",
    options: WatchOptions,
    keys: "Keys | None",
) -> int:
    """Show what comes until the end; returns the number of attitudes."""
    started_s = time.monotonic()
    hint_s = started_s + HINT_AFTER_S
    count, seen = options.most or inf, 0
    while not stop.is_set():
        for key, payload in inbox.drain(WAIT_S):
            hint_s = inf
            if seen >= count:
                break
            seen += display.show(key, payload)
        if keys is not None:
            display.press(keys.pressed())
        display.refresh()
        now_s = time.monotonic()
        if seen >= count or display.closed or now_s - started_s >= (options.seconds or inf):
            break
        if now_s >= hint_s:
            hint_s = inf
            display.say(f"nothing on {_key(options)} yet{NOBODY} (Ctrl-C ends)")
    return seen


def _key(options: WatchOptions) -> str:
    return f"{options.zenoh.prefix}/{options.vehicle or '*'}/attitude"
