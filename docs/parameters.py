# ruff: noqa: INP001 - a script for the documents, not of a package
"""Writes the lists of parameters.md from the types that hold the parameters.

``python docs/parameters.py`` renews the page, ``--check`` only checks that it is up to date.
"""

import inspect
import re
import sys
from pathlib import Path
from typing import get_args, get_type_hints

from msgspec import Meta

from estimator import bounds, profile
from estimator.aiding.types import AidingParams
from estimator.conditioning.params import ConditioningParams

PAGE = Path(__file__).with_name("parameters.md")
TYPES = {"conditioning": ConditioningParams, "aiding": AidingParams}
FIELD = re.compile(r"    (\w+): \w+ = (.*)")
# Tables that people write; only their bounds are filled in. Not every key in them is a number.
WRITTEN = {
    "reference": profile.Reference,
    "filter": profile.Filter,
    "confidence": profile.Confidence,
}


def lines_of(kind: type) -> list[str]:
    """One line for each parameter; a comment of its own in the source becomes a heading."""
    lines, found = inspect.getsource(kind).splitlines(), []
    defaults = kind._field_defaults  # type: ignore[attr-defined]
    heading: list[str] = []
    for number, line in enumerate(lines):
        if comment := re.fullmatch(r"    # (.*)", line):
            heading.append(comment[1])
        elif field := FIELD.fullmatch(line):
            if heading:
                found += ["", f"**{' '.join(heading).rstrip('.')}**", ""]
                heading = []
            name, rest = field.groups()
            text = rest.partition("  # ")[2]
            if rest == "(":  # the value has a line of its own, with the comment
                text = lines[number + 1].partition("  # ")[2]
            value = _value_text(defaults[name])
            found.append(f"- `{name}` ({value})" + (f": {text}" if text else ""))
    return found


def bounds_of_kinds() -> str:
    """What each kind of number may be, in one sentence."""
    kinds = {name: get_args(hint) for name, hint in vars(bounds).items()}
    reported = [
        f"{name.lower()} {_bounds_text(marks[1].ge, marks[1].le)}"
        for name, marks in kinds.items()
        if len(marks) == 2 and isinstance(marks[1], Meta)
    ]
    return f"Bounds by the kind of number, in its unit: {', '.join(reported)}."


def fill_bounds(text: str) -> str:
    """The page with bounds filled in where people write the rest of a table."""
    for section, kind in WRITTEN.items():
        start = text.index(f"\n## {section}\n")
        end = text.index("\n## ", start + 1)
        table = text[start:end]
        for name, hint in get_type_hints(kind, include_extras=True).items():
            marks = [mark for mark in get_args(hint) if isinstance(mark, Meta)]
            within = _bounds_text(marks[0].ge, marks[0].le) if marks else ""
            table = re.sub(
                rf"(\| `{name}` \| [^|]* \|)[^|]*\|",
                lambda found, within=within: f"{found[1]} {within} |",
                table,
            )
        text = text[:start] + table + text[end:]
    return text


def page() -> str:
    """The page with its lists and bounds renewed."""
    text = fill_bounds(PAGE.read_text("utf-8"))
    lists = {name: "\n".join(lines_of(kind)).strip("\n") for name, kind in TYPES.items()}
    for name, listed in (lists | {"bounds": bounds_of_kinds()}).items():
        text = re.sub(
            rf"(<!-- {name} -->\n).*?(\n<!-- end -->)",
            lambda found, listed=listed: f"{found[1]}\n{listed}\n{found[2]}",
            text,
            flags=re.DOTALL,
        )
    return text


def _bounds_text(low: float | None, high: float | None) -> str:
    return f"{low:.5g}–{high:.5g}"


def _value_text(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.4g}"


if __name__ == "__main__":
    new = page()
    if "--check" in sys.argv:
        sys.exit(new != PAGE.read_text("utf-8"))
    PAGE.write_text(new, "utf-8")
