"""The Zenoh options that run and watch share."""

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Annotated, NamedTuple

from fuzzbee import options
from fuzzbee.notify import notify

if TYPE_CHECKING:
    import zenoh

    from service.zenoh_session import OpeningSession

PREFIX = "fuzzbee"
NONE: list[str] = []  # given

option = partial(options.option, panel="Zenoh")
_LISTEN = "Listen here instead of tcp/127.0.0.1:7447 (repeatable)."
_CONNECT = "Connect there instead of to tcp/127.0.0.1:7447 (repeatable)."
_CONFIG = "A Zenoh configuration (JSON5) instead of the default session."
_SETTING = "One Zenoh setting, applied last (repeatable)."


class ZenohArguments(NamedTuple):
    """What was asked for on the command line."""

    listen: Annotated[list[str], option(_LISTEN, "--listen", "-l", metavar="ENDPOINT")] = NONE
    connect: Annotated[list[str], option(_CONNECT, "--connect", "-e", metavar="ENDPOINT")] = NONE
    mode: Annotated[str, option("peer or client.", "--mode", "-m")] = "peer"
    config_file: Annotated[str | None, option(_CONFIG, "--config", "-c", metavar="FILE")] = None
    settings: Annotated[list[str], option(_SETTING, "--cfg", metavar="KEY:JSON5")] = NONE
    multicast: Annotated[bool, option("Look for peers by multicast.")] = False
    prefix: Annotated[str, option("What all keys begin with.")] = PREFIX


def opening(arguments: ZenohArguments) -> "closing[OpeningSession]":
    """A session on its way, half a second, in which all else is loaded; closed at the end."""
    from service.zenoh_session import OpeningSession, ZenohOptions

    return closing(OpeningSession(ZenohOptions(*arguments)))


def opened(awaited: "OpeningSession") -> "zenoh.Session":
    """The session, once it is open; a line says what it lacks."""
    session = awaited.session()
    if awaited.note is not None:
        notify(awaited.note)
    return session
