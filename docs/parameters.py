# ruff: noqa: INP001 - a script for the documents, not of a package
"""Writes the tables of parameters.md from the types that hold the parameters.

``python docs/parameters.py`` renews the page, ``--check`` only tells whether it is up to date.
"""

import inspect
import re
import sys
from pathlib import Path

from estimator.aiding.types import AidingParams
from estimator.conditioning.types import ConditioningParams

PAGE = Path(__file__).with_name("parameters.md")
TYPES = {"conditioning": ConditioningParams, "aiding": AidingParams}
FIELD = re.compile(r"    (\w+): (?:bool|float) = (.*)")


def rows(kind: type) -> list[str]:
    """A row a parameter; headings where the source has a comment of its own."""
    lines, found = inspect.getsource(kind).splitlines(), []
    defaults = kind._field_defaults  # type: ignore[attr-defined]
    for number, line in enumerate(lines):
        if heading := re.fullmatch(r"    # (.*)", line):
            found.append(f"| **{heading[1].rstrip('.')}** | | |")
        elif field := FIELD.fullmatch(line):
            name, rest = field.groups()
            comment = rest.partition("  # ")[2]
            if rest == "(":  # the value has a line of its own, with the comment
                comment = lines[number + 1].partition("  # ")[2]
            found.append(f"| `{name}` | {_value(defaults[name])} | {comment} |")
    return found


def page() -> str:
    """The page with its tables renewed."""
    text = PAGE.read_text("utf-8")
    for name, kind in TYPES.items():
        table = "\n".join(["| key | default | what it does |", "| --- | --- | --- |", *rows(kind)])
        text = re.sub(
            rf"(<!-- {name} -->\n).*?(\n<!-- end -->)",
            lambda found, table=table: found[1] + table + found[2],
            text,
            flags=re.DOTALL,
        )
    return text


def _value(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.4g}"


if __name__ == "__main__":
    new = page()
    if "--check" in sys.argv:
        sys.exit(new != PAGE.read_text("utf-8"))
    PAGE.write_text(new, "utf-8")
