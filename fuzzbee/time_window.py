"""``--from`` and ``--to``: the part of a log that a verb looks at."""

from math import inf
from typing import Annotated, Any

from drivers.logs.time_window import Moment, TimeWindow
from estimator.errors import InputError
from fuzzbee.options import of_source

_FROM = "Begin there: seconds of the log, arm or disarm."
_TO = "End there: seconds of the log, arm or disarm."

From = Annotated[str | None, of_source(_FROM, "--from", metavar="S|arm")]
To = Annotated[str | None, of_source(_TO, "--to", metavar="S|disarm")]


def time_window(begin: Any, end: Any, names: tuple[str, str] = ("--from", "--to")) -> TimeWindow:
    """The window between two moments: seconds as a number or text, "arm", "disarm" or None.

    Raises:
        InputError: a moment of another kind, or an end that is not behind the beginning.
    """
    window = TimeWindow(_moment(names[0], begin), _moment(names[1], end))
    first, last = window
    if isinstance(first, float) and isinstance(last, float) and last <= first:
        raise InputError(f"{names[1]} {last:g}: must be later than {names[0]} {first:g}")
    return window


def _moment(name: str, given: Any) -> Moment | None:
    if given is None or given in ("arm", "disarm"):
        return given  # type: ignore[no-any-return]
    try:
        seconds = float(given)
    except (TypeError, ValueError):
        seconds = -inf
    if not 0.0 <= seconds < inf:
        raise InputError(f"{name} {given!s:.60}: must be seconds (0 or more), arm or disarm")
    return seconds
