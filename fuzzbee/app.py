"""All verbs as one application; nothing heavy is imported, so that ``--help`` is quick."""

from collections import defaultdict
from typing import Annotated, Any

import typer

from fuzzbee import calibrate, check, profile, run, sim, watch
from fuzzbee.replays import command as replay
from fuzzbee.tune import command as tune
from fuzzbee.version import __version__

VERBS = (run.run, sim.sim, watch.watch, replay.replay, check.check, calibrate.calibrate, tune.tune)
EPILOG = """Start here:

  fuzzbee run sim:flight         the service on its built-in vehicle

  fuzzbee watch                  in another terminal: what it publishes

  fuzzbee COMMAND --help         options and examples"""


class Grouped(typer.core.TyperCommand):
    """A verb whose plain help has its options by panels, as the decorated one has."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options, panel by panel."""
        panels = defaultdict[str, list[tuple[str, str]]](list)
        for parameter in self.get_params(ctx):
            if (row := parameter.get_help_record(ctx)) is not None:
                kind = f"{parameter.param_type_name.title()}s"
                panels[getattr(parameter, "rich_help_panel", None) or kind].append(row)
        for name, rows in panels.items():
            with formatter.section(name):
                formatter.write_dl(rows)


def build_command(*, decorated: bool) -> Any:
    """All verbs; ``decorated`` help has boxes and colours, for a terminal, and is slower."""
    app = typer.Typer(
        name="fuzzbee",
        help="Estimate a vehicle's attitude from its MAVLink stream, live.",
        epilog=EPILOG,
        invoke_without_command=True,
        rich_markup_mode="rich" if decorated else None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
    )
    app.callback()(_main_options)
    for verb in VERBS:
        app.command(cls=Grouped, epilog=verb.epilog)(verb)
    app.add_typer(profile.profile_app, name="profile")
    made = typer.main.get_command(app)
    if decorated:
        _escape_markup(made)
    return made


def _escape_markup(command: Any) -> None:
    """Have brackets in help texts printed: Rich takes ``[default: imu]`` for a style."""
    from rich.markup import escape

    command.epilog = escape(command.epilog or "")
    for parameter in command.params:
        if getattr(parameter, "help", None):
            parameter.help = escape(parameter.help)
    for verb in getattr(command, "commands", {}).values():
        _escape_markup(verb)


def _main_options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
    verbose: Annotated[  # noqa: ARG001 - read from the arguments by main
        bool, typer.Option("--verbose", "-v", help="Log more on standard error.")
    ] = False,
) -> None:
    if version:
        print(f"fuzzbee {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())
