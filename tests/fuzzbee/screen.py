"""What views show: a terminal drawn by pyte, lines, and a file of Rerun's read by its program."""

import io
import re
import subprocess

import msgspec
import pytest
from rich.console import Console

from drivers.events import VehicleId
from fuzzbee.terminal import TerminalView
from fuzzbee.viewer.process import program
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


def listing(path, *options):
    command = [program(), "rrd", "print", *(options or ("-vv",)), path]
    return subprocess.check_output(command, text=True)


def rows(path, entity):
    """How often something was drawn there."""
    pattern = rf"with (\d+) rows \(.*?\) - {re.escape(entity)} - data"
    return sum(map(int, re.findall(pattern, listing(path, "-v"))))


def chunks(path):
    """How many pieces have points."""
    kinds = "scalars|quaternion|vectors"
    return len(re.findall(rf"rows \(.*?\) - /\S+ - data.*(?:{kinds})", listing(path, "-v")))


def numbers(path, entity):
    """What was drawn there, a list of numbers a row."""
    text = listing(path, "-vvv", "--entity", entity)
    found = re.findall(r"row_\w+ +┆ \d{4}-\S+ +┆ \[+([^\]]*)\]+", text)
    return [[float("nan" if x == "null" else x) for x in row.split(", ")] for row in found]
