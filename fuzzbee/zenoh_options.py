"""The Zenoh options that run and watch share."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.zenoh_session import ZenohOptions

PANEL = "Zenoh"

Listen = Annotated[
    list[str] | None,
    typer.Option(
        "--listen",
        "-l",
        metavar="ENDPOINT",
        help="Listen here instead of tcp/127.0.0.1:7447 (repeatable).",
        rich_help_panel=PANEL,
    ),
]
Connect = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        "-e",
        metavar="ENDPOINT",
        help="Connect there instead of to tcp/127.0.0.1:7447 (repeatable).",
        rich_help_panel=PANEL,
    ),
]
Mode = Annotated[str, typer.Option("--mode", "-m", help="peer or client.", rich_help_panel=PANEL)]
ConfigFile = Annotated[
    str | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        help="A Zenoh configuration (JSON5) instead of the default session.",
        rich_help_panel=PANEL,
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--cfg",
        metavar="KEY:JSON5",
        help="One Zenoh setting, applied last (repeatable).",
        rich_help_panel=PANEL,
    ),
]
Multicast = Annotated[
    bool,
    typer.Option("--multicast", help="Look for peers by multicast.", rich_help_panel=PANEL),
]
Prefix = Annotated[
    str, typer.Option("--prefix", help="What all keys begin with.", rich_help_panel=PANEL)
]


def zenoh_options(
    *,
    listen: list[str] | None,
    connect: list[str] | None,
    mode: str,
    config_file: str | None,
    settings: list[str] | None,
    multicast: bool,
    prefix: str,
) -> "ZenohOptions":
    """The options as one value."""
    from service.zenoh_session import ZenohOptions

    return ZenohOptions(
        listen=tuple(listen or ()),
        connect=tuple(connect or ()),
        mode=mode,
        config_file=config_file,
        settings=tuple(settings or ()),
        multicast=multicast,
        prefix=prefix,
    )
