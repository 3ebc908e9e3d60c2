"""Options as fields: a verb takes one named tuple, whose fields are its arguments and options.

What checks a value raises an InputError that names the option and the value.
"""

import inspect
from collections.abc import Callable, Iterator
from copy import copy
from functools import partial, wraps
from importlib.util import find_spec
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

import typer
from typer.models import OptionInfo

from estimator.errors import InputError, missing_extra
from fuzzbee.notify import notify

if TYPE_CHECKING:
    from drivers.logs.time_window import Moment, TimeWindow
    from service.zenoh_session import OpeningSession

PROFILES = ("paper", "imu", "adaptive")
SIMULATION = "sim:"  # the paper's signals, in place of a log

KEYWORD = inspect.Parameter.KEYWORD_ONLY


def option(
    text: str, *names: str, default: Any = None, words: tuple[str, ...] = (), **more: Any
) -> Any:
    """A field that is an option, with its help; called as the field is unless ``names`` are given.

    ``words`` are what a shell may complete; ``more`` goes to typer.
    """
    if words:
        more["autocompletion"] = lambda: list(words)
    return typer.Option(default, *names, help=text, **more)


# Those of a panel stand together in the help.
source, estimate, publishing, recording, showing, of_zenoh = (
    partial(option, rich_help_panel=panel)
    for panel in ("Source", "Estimate", "Publish", "Record", "Show", "Zenoh")
)


def examples(*lines: str) -> str:
    """What stands below a verb's help."""
    return "\n\n".join(["Examples:", *(f"  {line}" for line in lines)])


SYSTEM_ID = source("Which vehicle. [default: the one with most IMU samples]", metavar="ID")
BEGIN = source("Begin there: seconds of the log, arm or disarm.", "--from", metavar="S|arm")
END = source("End there: seconds of the log, arm or disarm.", "--to", metavar="S|disarm")
SECONDS = source("End after N seconds.", metavar="N")
RETUNE = estimate("Retune a few numbers whenever the sensors' noise changes.", default=False)
JSON = showing("JSON on standard output, nothing else there.", "--json", default=False)
INSECURE = "Take a key file that others may read."
VERBOSE = showing("Log more on standard error.", "--verbose", "-v", default=False)


def command(*lines: str) -> Callable[[Callable[[Any], Any]], Any]:
    """The verb as typer takes it: a parameter for each field of the named tuple that it takes.

    A field that is a named tuple itself stands for that one's fields. The lines are examples.
    """

    def decorated(verb: Callable[[Any], Any]) -> Any:
        options = next(iter(get_type_hints(verb).values()))
        parameters = [*_parameters(options)]
        call: Any = wraps(verb)(lambda **given: verb(_made(options, given)))
        call.__annotations__ = {each.name: each.annotation for each in parameters}
        call.__signature__ = inspect.Signature(parameters)
        call.epilog = examples(*lines)
        return call

    return decorated


def _parameters(options: Any) -> Iterator[inspect.Parameter]:
    kinds = get_type_hints(options)
    for name, default in options._field_defaults.items():
        if hasattr(default, "_fields"):
            yield from _parameters(type(default))
            continue
        info = copy(default)
        if isinstance(info, OptionInfo) and kinds[name] in (Path, Path | None):
            info.metavar = info.metavar or "FILE"
        if isinstance(info, OptionInfo) and not info.param_decls:
            info.param_decls = (flag_of(name),)  # typer's own name would give flags a second one
        yield inspect.Parameter(name, KEYWORD, default=info, annotation=kinds[name])


def _made(options: Any, given: dict[str, Any]) -> Any:
    """The options, and those in them, of the values that were given."""
    values = (
        _made(type(default), given) if hasattr(default, "_fields") else given[name]
        for name, default in options._field_defaults.items()
    )
    return options(*values)


def flag_of(name: str) -> str:
    """How a field is called on the command line."""
    return f"--{name.replace('_', '-')}"


def asked_for(options: Any, *names: str) -> dict[str, Any]:
    """By their flags those of these fields that are not as without."""
    infos = options._field_defaults
    return {
        next(iter(infos[name].param_decls), flag_of(name)): value
        for name in names
        if (value := getattr(options, name)) != infos[name].default
    }


def require_extra(package: str, what: str, extra: str) -> None:
    """Refuse, before any work, what needs a package that only an extra brings."""
    if find_spec(package) is None:
        raise missing_extra(what, extra)


def require_positive(options: Any, *names: str) -> None:
    """Refuse zero, negative numbers, infinity and NaN in these fields."""
    for flag, value in asked_for(options, *names).items():
        if not (isfinite(value) and value > 0.0):
            raise InputError(f"{flag} {value:g}: should be a number above 0")


def seed_range(text: str, name: str = "--seeds") -> range:
    """``A-B``, both included, or a single ``A``."""
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise InputError(f"{name} {text}: must be A-B with whole numbers, such as 0-19")
    seeds = range(int(first), int(last or first) + 1)
    if not seeds:
        raise InputError(f"{name} {text}: the range is empty")
    return seeds


def time_window(begin: Any, end: Any, names: tuple[str, str] = ("--from", "--to")) -> "TimeWindow":
    """The window between two moments: seconds as a number or text, "arm", "disarm" or None."""
    from drivers.logs.time_window import TimeWindow  # which loads msgspec

    window = TimeWindow(_moment(names[0], begin), _moment(names[1], end))
    first, last = window
    if isinstance(first, float) and isinstance(last, float) and last <= first:
        raise InputError(f"{names[1]} {last:g}: must be later than {names[0]} {first:g}")
    return window


def _moment(name: str, given: Any) -> "Moment | None":
    if given is None or given in ("arm", "disarm"):
        return given  # type: ignore[no-any-return]
    try:
        seconds = float(given)
    except (TypeError, ValueError):
        seconds = -inf
    if not 0.0 <= seconds < inf:
        raise InputError(f"{name} {given!s:.60}: must be seconds (0 or more), arm or disarm")
    return seconds


_LISTEN = "Listen here instead of tcp/127.0.0.1:7447 (repeatable)."
_CONNECT = "Connect there instead of to tcp/127.0.0.1:7447 (repeatable)."
_CONFIG = "A Zenoh configuration (JSON5) instead of the default session."
_endpoints = partial(of_zenoh, default=[], metavar="ENDPOINT")


class ZenohArguments(NamedTuple):
    """What run and watch are asked for of the session that they share."""

    listen: list[str] = _endpoints(_LISTEN, "--listen", "-l")
    connect: list[str] = _endpoints(_CONNECT, "--connect", "-e")
    mode: str = of_zenoh("peer or client.", "--mode", "-m", default="peer")
    config_file: str | None = of_zenoh(_CONFIG, "--config", "-c", metavar="FILE")
    settings: list[str] = of_zenoh(
        "One Zenoh setting, applied last (repeatable).", "--cfg", default=[], metavar="KEY:JSON5"
    )
    multicast: bool = of_zenoh("Look for peers by multicast.", default=False)
    prefix: str = of_zenoh("What all keys begin with.", default="fuzzbee")


def opening(arguments: ZenohArguments) -> "OpeningSession":
    """A session on its way, half a second, in which all else is loaded; closed at the end."""
    from service.zenoh_session import OpeningSession, ZenohOptions

    return OpeningSession(ZenohOptions(*arguments), notify)
