"""``fuzzbee watch``: subscribe and show attitudes."""

import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from math import inf
from threading import Event
from typing import TYPE_CHECKING, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee.notify import notify
from fuzzbee.outputs import WEB

if TYPE_CHECKING:
    from fuzzbee.reception import Reception, Record
    from fuzzbee.terminal import TerminalView

HINT_AFTER_S = 3.0
WAIT_S = 0.1
NOBODY = ": is fuzzbee run started, with the same Zenoh options?"
FAILED = 1
_VEHICLE = "Only this vehicle (system id, or S-C): on a terminal an artificial horizon."


class WatchOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    vehicle: str | None = typer.Argument(None, help=_VEHICLE, show_default=False)
    most: int | None = opt.source("End after N attitudes.", "--count", "-n", metavar="N")
    seconds: float | None = opt.SECONDS
    as_json: bool = opt.showing(
        "One JSON object a line, for each attitude.", "--json", default=False
    )
    web: str | None = opt.showing(WEB, metavar="[ADDRESS:]PORT")
    zenoh: opt.ZenohArguments = opt.ZenohArguments()
    verbose: bool = opt.VERBOSE  # read by the command line itself


@opt.command(
    "fuzzbee watch",
    "fuzzbee watch 1",
    "fuzzbee watch --json -n 100 > attitudes.jsonl",
    "fuzzbee watch -m client -e tcp/192.168.1.10:7447",
)
def watch(options: WatchOptions) -> int:
    """Show what a running service publishes.

    On a terminal q quits, s sorts, the arrows choose a vehicle and Enter shows it alone.
    """
    from fuzzbee.reception import VEHICLE

    opt.require_positive(options, "seconds")
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


def follow(options: WatchOptions) -> int:
    """Show what comes until stopped; 1 if a bounded watch got less than was asked for."""
    from fuzzbee.reception import Reception
    from fuzzbee.terminal import PersonConsole, TerminalView, terminal_keys
    from service.signals import stop_on_signals

    stop, view = Event(), None
    keys: Callable[[], list[str]] = list
    prefix, name = options.zenoh.prefix, options.vehicle or "*"
    with ExitStack() as stack:
        session = stack.enter_context(opt.opening(options.zenoh)).session()
        stack.enter_context(stop_on_signals(stop.set))
        if not options.as_json:
            title = f"fuzzbee watch {prefix}/*"
            consoles = PersonConsole(), PersonConsole(stderr=True)
            view = stack.enter_context(closing(TerminalView(*consoles, title, one=options.vehicle)))
            if options.web is not None:
                from fuzzbee.web.server import open_page

                stack.enter_context(closing(open_page(options.web, title, view.model)))
            name = "*" if view.is_live else name  # a person may go back from one vehicle to all
            keys = stack.enter_context(terminal_keys())
        reception = Reception(notify if view is None else view.notify)
        for kind in ("attitude",) if view is None else ("status", "attitude"):
            session.declare_subscriber(f"{prefix}/{name}/{kind}", reception.put)
        seen = _loop(reception, stop, view, options, keys)
    if (view is not None and view.is_closed) or stop.is_set() or seen >= (options.most or 1):
        return 0
    found = f"{seen} attitudes" if seen else "no attitude"
    notify(f"{found} on {_key(options)} in {options.seconds:g} s{'' if seen else NOBODY}")
    return FAILED


def _loop(
    reception: "Reception",
    stop: Event,
    view: "TerminalView | None",
    options: WatchOptions,
    keys: Callable[[], list[str]],
) -> int:
    """Show what comes until the end; returns the number of attitudes."""
    started_s, seen, most, has_hinted = time.monotonic(), 0, options.most or inf, False
    while not stop.is_set():
        for name, record in reception.records(WAIT_S):
            if seen < most:
                seen += show(name, record, view, options.vehicle)
        if view is not None:
            view.press(keys())
            view.refresh()
        lasted_s = time.monotonic() - started_s
        is_over = seen >= most or lasted_s >= (options.seconds or inf)
        if is_over or (view is not None and view.is_closed):
            break
        if not (reception.has_heard or has_hinted) and lasted_s >= HINT_AFTER_S:
            has_hinted = True
            reception.notify(f"nothing on {_key(options)} yet{NOBODY} (Ctrl-C ends)")
    return seen


def show(
    name: str, record: "Record", view: "TerminalView | None", vehicle: str | None = None
) -> bool:
    """Show a vehicle's record, without a view as a line of JSON; whether it counts.

    Attitudes of the ``vehicle`` count, of all if it is None.
    """
    from service.records import AttitudeRecord

    if view is None:
        import msgspec

        line = msgspec.json.encode({"vehicle": name, **msgspec.structs.asdict(record)})
        print(line.decode(), flush=True)
    else:
        view.model.update(name, record, time.monotonic())
    return isinstance(record, AttitudeRecord) and vehicle in (None, name)


def _key(options: WatchOptions) -> str:
    return f"{options.zenoh.prefix}/{options.vehicle or '*'}/attitude"
