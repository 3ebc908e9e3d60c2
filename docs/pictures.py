# ruff: noqa: INP001 - a script for the documents, not of a package
"""Makes watch.svg, watch-one.svg and viewer.png of recorded flights.

``python docs/pictures.py`` renews all three; names after it choose some. viewer.png needs Chromium
and the extra ``viewer``. Each flight goes through the service's own pipeline up to a moment that
shows something; nothing is drawn that ``watch`` and ``run --view web`` would not draw.
"""

import io
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.terminal_theme import MONOKAI

from drivers.events import Imu
from drivers.logs.open import open_log
from estimator.profile import load_profile
from fuzzbee.horizon import screen
from fuzzbee.latest import Latest
from fuzzbee.vehicle_table import table
from service.pipeline import Pipeline
from service.records import Output, Published

if TYPE_CHECKING:
    from tests.fuzzbee.browser import Page

FOLDER = Path(__file__).parent
DATA = FOLDER.parent / "tests" / "data"
TICK_US = 50_000
# Each is a vehicle of watch.svg: its name there, its flight, and the moment in seconds.
FLEET = (
    ("1", "sitl_copter_flips.tlog", 13.0),
    ("2", "sitl_plane_4hz.tlog", 140.0),
    ("3", "rover_no_magnetometer.tlog", 50.0),
)
ONE = ("2", "sitl_plane_4hz.tlog", 56.0)
VIEWED = ("sitl_plane_4hz.tlog", 56.0)
WIDTH, HEIGHT = 80, 23
# A browser that draws in software takes a while to show all; it has when nothing changes any more.
STILL_S, PATIENCE_S = 20.0, 400.0


def outputs(log: str, until_s: float) -> Iterator[list[Output]]:
    """What the service publishes, tick by tick, until a moment of the flight."""
    pipeline = Pipeline(load_profile("imu"))
    begin_us = due_us = None
    with open_log(DATA / log) as events:
        for event in events:
            if isinstance(event, Imu):
                begin_us = event.arrival_us if begin_us is None else begin_us
                due_us = event.arrival_us if due_us is None else due_us
                while due_us <= min(event.arrival_us, begin_us + round(1e6 * until_s)):
                    yield pipeline.tick(due_us)
                    due_us += TICK_US
                if event.arrival_us > begin_us + 1e6 * until_s:
                    return
            pipeline.handle(event)


def fly(model: Latest, name: str, log: str, until_s: float) -> None:
    """Put a vehicle as it is at that moment into the model."""
    for turn in outputs(log, until_s):
        for output in turn:
            if isinstance(output, Published):
                model.update(name, output.record, 0.0)


def draw_watch() -> None:
    """Several vehicles in a table."""
    model = Latest()
    for vehicle in FLEET:
        fly(model, *vehicle)
    shown = table(model.rows(), WIDTH, HEIGHT, "fuzzbee watch fuzzbee/*")
    save("watch.svg", "fuzzbee watch", shown, 5)


def draw_watch_one() -> None:
    """One vehicle as an artificial horizon."""
    model = Latest()
    fly(model, *ONE)
    console = Console(color_system="truecolor", force_terminal=True, file=io.StringIO())
    shown = screen(model.rows()[0], WIDTH, HEIGHT, console)
    save("watch-one.svg", f"fuzzbee watch {ONE[0]}", shown, HEIGHT)


def save(name: str, title: str, shown: RenderableType, height: int) -> None:
    """Write a terminal with something in it."""
    console = Console(
        width=WIDTH,
        height=height,
        record=True,
        file=io.StringIO(),
        force_terminal=True,
        color_system="truecolor",
    )
    console.print(shown)
    picture = console.export_svg(
        title=title, theme=MONOKAI, unique_id=name.split(".", maxsplit=1)[0]
    )
    # a page of documents must fetch nothing
    lines = [line for line in picture.split("\n") if "cdnjs" not in line and "<!--" not in line]
    (FOLDER / name).write_text("\n".join(lines), "utf-8")


def draw_viewer() -> None:
    """The page that a browser shows."""
    from fuzzbee.viewer.viewer import ViewerSink
    from tests.fuzzbee import browser

    sink = ViewerSink(view="web")
    try:
        for turn in outputs(*VIEWED):
            sink.handle(turn)
        sink.finish()
        with (
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
            browser.page(sink.process.page, folder) as page,
        ):
            (FOLDER / "viewer.png").write_bytes(still_picture(page))
    finally:
        sink.close()


def still_picture(page: "Page") -> bytes:
    """A page's picture once it has been the same for a while."""
    begin_s = changed_s = time.monotonic()
    picture = b""
    while (now_s := time.monotonic()) < begin_s + PATIENCE_S:
        before, picture = picture, page.screenshot()
        if picture != before:
            changed_s = now_s
        elif now_s - changed_s > STILL_S:
            break
        time.sleep(1.0)
    return picture


PICTURES = {"watch": draw_watch, "watch-one": draw_watch_one, "viewer": draw_viewer}


def main() -> None:
    """Draw those that are named, or all."""
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()


if __name__ == "__main__":
    main()
