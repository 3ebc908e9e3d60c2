# ruff: noqa: INP001 - a script for the documents, not of a package
"""Runs the Python blocks of tour.md, and writes what they print and draw.

``python docs/tour.py`` renews the page and its pictures. The blocks share their names, as in a
notebook; what one prints stands behind it.
"""

import io
import re
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("tour.md")
LOG = Path(__file__).parents[1] / "tests" / "data" / "sitl_copter_flips.tlog"
BLOCK = re.compile(r"(```python\n(.*?)```\n)(\n```text\n.*?```\n)?", re.DOTALL)


def run_page(text: str, folder: Path) -> str:
    """The page with what its blocks print; their pictures are written to the folder."""
    import matplotlib as mpl

    names: dict[str, Any] = {}

    def run_block(found: re.Match[str]) -> str:
        printed = io.StringIO()
        with redirect_stdout(printed):
            exec(compile(found[2], "tour.md", "exec"), names)  # noqa: S102 - our own page
        shown = printed.getvalue()
        return found[1] + (f"\n```text\n{shown}```\n" if shown else "")

    log = folder / "flight.tlog"
    log.write_bytes(LOG.read_bytes())
    try:
        with chdir(folder), mpl.rc_context({"backend": "agg"}):
            return BLOCK.sub(run_block, text)
    finally:
        log.unlink()


if __name__ == "__main__":
    PAGE.write_text(run_page(PAGE.read_text("utf-8"), PAGE.parent), "utf-8")
