"""What the view of the command shows: on a terminal drawn by pyte, or as lines in a file."""

import io

import msgspec
import pytest
from rich.console import Console

from drivers.events import VehicleId
from fuzzbee.terminal import TerminalView
from service.records import Published
from tests.service.records import STATUS, record


def vehicle(name="1", attitude=None, state="running", status=STATUS, **changes):
    """A vehicle's status, and its attitude if its state has one; ``changes`` are the status's."""
    address = VehicleId(*map(int, f"{name}-1".split("-")[:2]))
    status = msgspec.structs.replace(status, state=state, **changes)
    attitude = msgspec.structs.replace(attitude or record(-12.34, 5.0, 359.97), state=state)
    return [Published(address, attitude), Published(address, status)]


def terminal(*vehicles, width=80, height=24, one=None, after_s=0.0, keys=(), encoding="utf-8"):
    """The lines of a terminal ``after_s`` after the vehicles' outputs and the keys."""
    pyte = pytest.importorskip("pyte")
    file = io.TextIOWrapper(io.BytesIO(), encoding, errors="replace")
    console = Console(file=file, width=width, height=height, force_terminal=True, color_system=None)
    now_s = [10.0]
    view = TerminalView(console, console, "title", lambda: now_s[0], one)
    view.handle([output for outputs in vehicles for output in outputs])
    view.press(keys)
    now_s[0] += after_s
    view.refresh()
    view.close()
    file.flush()
    screen = pyte.Screen(width, height)
    pyte.Stream(screen).feed(file.buffer.getvalue().decode(encoding).replace("\n", "\r\n"))
    return [line.rstrip() for line in screen.display]


def lines(*vehicles, after_s=0.0):
    """The lines where there is no terminal."""
    out, now_s = io.StringIO(), [10.0]
    console = Console(file=out, width=40)
    view = TerminalView(console, console, "title", lambda: now_s[0])
    view.model.take([output for outputs in vehicles for output in outputs], now_s[0])
    now_s[0] += after_s
    view.refresh()
    return out.getvalue().splitlines()
