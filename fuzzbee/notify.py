"""Lines for a person, on standard error: printable whatever they hold, and never an error."""

import sys
from contextlib import suppress

LONGEST_LINE = 1000  # characters


def notify(text: str, who: str = "fuzzbee: ") -> None:
    """Print one line. A standard error that is closed, broken or full is no fault of ours."""
    with suppress(OSError, ValueError):
        print(f"{who}{printable(text)}", file=sys.stderr, flush=True)


def print_line(text: str) -> None:
    """Print one line without the name of the program."""
    notify(text, "")


def printable(text: str, most: int = LONGEST_LINE) -> str:
    """The text as a terminal may show it: file names, vehicles and publishers choose the words.

    Control characters (escape sequences, line ends), marks that change the direction of writing
    and codes that are no character are written as Python escapes them. A text that is too long
    is cut.
    """
    if len(text) > most:
        text = text[: most - 1] + "…"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
