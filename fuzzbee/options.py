"""Options as fields: a verb takes one named tuple, whose fields are its arguments and options.

What checks a value raises an InputError that names the option and the value.
"""

import inspect
from collections.abc import Callable, Iterator
from contextlib import closing
from copy import copy
from functools import partial, wraps
from importlib.util import find_spec
from math import inf, isfinite
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

import typer
from typer.models import OptionInfo

from estimator.errors import InputError, missing_extra
from fuzzbee.notify import notify

if TYPE_CHECKING:
    import zenoh

    from drivers.logs.time_window import Moment, TimeWindow
    from service.zenoh_session import OpeningSession

MAX_GAIN = 1e6
PROFILES = ("paper", "imu", "adaptive")

Form = TypeVar("Form", bound=NamedTuple)
Result = TypeVar("Result")


def option(
    text: str, *names: str, panel: str | None = None, words: tuple[str, ...] = (), **more: Any
) -> OptionInfo:
    """An option with its help; named as its field is unless ``names`` are given.

    Those of a ``panel`` stand together in the help. ``words`` are what a shell may complete;
    ``more`` goes to typer.
    """
    if words:
        more["autocompletion"] = lambda: list(words)
    made: OptionInfo = typer.Option(*names, help=text, rich_help_panel=panel, **more)
    return made


of_source = partial(option, panel="Source")
of_estimate = partial(option, panel="Estimate")
of_publishing = partial(option, panel="Publish")
of_recording = partial(option, panel="Record")
of_showing = partial(option, panel="Show")
of_zenoh = partial(option, panel="Zenoh")


def examples(*lines: str) -> str:
    """What stands below a verb's help."""
    return "\n\n".join(["Examples:", *(f"  {line}" for line in lines)])


_FROM = "Begin there: seconds of the log, arm or disarm."
_TO = "End there: seconds of the log, arm or disarm."
Verbose = Annotated[bool, of_showing("Say more on standard error.", "--verbose", "-v")]
Json = Annotated[bool, of_showing("JSON on standard output, nothing else there.", "--json")]
From = Annotated[str | None, of_source(_FROM, "--from", metavar="S|arm")]
To = Annotated[str | None, of_source(_TO, "--to", metavar="S|disarm")]
Retune = Annotated[bool, of_estimate("Retune a few numbers whenever the sensors' noise changes.")]
Seconds = Annotated[float | None, of_source("End after N seconds.", metavar="N")]
NONE: list[str] = []
EMPTY, KEYWORD = inspect.Parameter.empty, inspect.Parameter.KEYWORD_ONLY

_LISTEN = "Listen here instead of tcp/127.0.0.1:7447 (repeatable)."
_CONNECT = "Connect there instead of to tcp/127.0.0.1:7447 (repeatable)."
_CONFIG = "A Zenoh configuration (JSON5) instead of the default session."
_SETTING = "One Zenoh setting, applied last (repeatable)."


def command(verb: Callable[[Form], Result]) -> Callable[..., Result]:
    """The verb as typer takes it: a parameter for each field of the named tuple that it takes.

    A field that is a named tuple itself stands for that one's fields.
    """
    form = next(iter(get_type_hints(verb).values()))
    parameters = [*_parameters(form)]

    @wraps(verb)
    def parsed(**given: Any) -> Result:
        return verb(_made(form, given))

    call: Any = parsed
    call.__annotations__ = {each.name: each.annotation for each in parameters}
    call.__signature__ = inspect.Signature(parameters)
    return parsed


def _parameters(form: Any) -> Iterator[inspect.Parameter]:
    for name, kind in get_type_hints(form, include_extras=True).items():
        if hasattr(kind, "_fields"):
            yield from _parameters(kind)
            continue
        base, info = get_args(kind)
        if isinstance(info, OptionInfo) and info.default is ...:
            info = copy(info)  # typer's own name would give flags a second one
            info.default = f"--{name.replace('_', '-')}"
        default = form._field_defaults.get(name, EMPTY)
        yield inspect.Parameter(name, KEYWORD, default=default, annotation=Annotated[base, info])


def _made(form: Any, given: dict[str, Any]) -> Any:
    """The named tuple, and those in it, of the values that were given."""
    kinds = get_type_hints(form).items()
    return form(*(_made(k, given) if hasattr(k, "_fields") else given[name] for name, k in kinds))


def require_gain(gain: float | None) -> None:
    """Refuse a fixed gain that is no number above 0, or beyond any use."""
    if gain is not None and not 0.0 < gain <= MAX_GAIN:
        raise InputError(f"--gain {gain:g}: K should be above 0 and at most {MAX_GAIN:g}")


def require_extra(package: str, what: str, extra: str) -> None:
    """Refuse, before any work, what needs a package that only an extra brings."""
    if find_spec(package) is None:
        raise missing_extra(what, extra)


def require_positive(name: str, value: float | None) -> None:
    """Refuse zero, negative numbers, infinity and NaN."""
    if value is not None and not (isfinite(value) and value > 0.0):
        raise InputError(f"{name} {value:g}: should be a number above 0")


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


class ZenohArguments(NamedTuple):
    """What run and watch are asked for of the session that they share."""

    listen: Annotated[list[str], of_zenoh(_LISTEN, "--listen", "-l", metavar="ENDPOINT")] = NONE
    connect: Annotated[list[str], of_zenoh(_CONNECT, "--connect", "-e", metavar="ENDPOINT")] = NONE
    mode: Annotated[str, of_zenoh("peer or client.", "--mode", "-m")] = "peer"
    config_file: Annotated[str | None, of_zenoh(_CONFIG, "--config", "-c", metavar="FILE")] = None
    settings: Annotated[list[str], of_zenoh(_SETTING, "--cfg", metavar="KEY:JSON5")] = NONE
    multicast: Annotated[bool, of_zenoh("Look for peers by multicast.")] = False
    prefix: Annotated[str, of_zenoh("What all keys begin with.")] = "fuzzbee"


def opening(arguments: ZenohArguments) -> "closing[OpeningSession]":
    """A session on its way, half a second, in which all else is loaded; closed at the end."""
    from service.zenoh_session import OpeningSession, ZenohOptions

    return closing(OpeningSession(ZenohOptions(*arguments)))


def opened(awaited: "OpeningSession") -> "zenoh.Session":
    """The session, once it is open; a line names what it lacks."""
    session = awaited.session()
    if awaited.note is not None:
        notify(awaited.note)
    return session
