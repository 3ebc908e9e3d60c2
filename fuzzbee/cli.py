"""The command line: arguments in, one function per verb out, an exit status back.

This file and the verbs import nothing heavy: that happens inside the
functions, so that ``--help`` and ``--version`` are quick.
"""

import os
import sys
import threading
from collections.abc import Sequence
from typing import Annotated

import typer

from estimator.errors import InputError
from fuzzbee import profile, replay, run, sim, tune, watch
from fuzzbee.version import __version__

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

HELP = "Estimate a vehicle's attitude from its MAVLink stream, live."

EPILOG = """Start here:

  fuzzbee run                    the service on its built-in vehicle

  fuzzbee watch                  in another terminal: what it publishes

  fuzzbee COMMAND --help         options and examples"""


def build_app(*, decorated: bool) -> typer.Typer:
    """All verbs; ``decorated`` help has boxes and colours, for a terminal."""
    app = typer.Typer(
        name="fuzzbee",
        help=HELP,
        epilog=EPILOG,
        no_args_is_help=False,
        invoke_without_command=True,
        add_completion=False,
        rich_markup_mode="rich" if decorated else None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
    )
    app.callback()(_main_options)
    for verb in (run, sim, watch, replay, tune):
        function = getattr(verb, verb.__name__.rpartition(".")[2])
        app.command(epilog=getattr(verb, "EPILOG", None))(function)
    app.add_typer(profile.profile_app, name="profile")
    return app


def _main_options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
    verbose: Annotated[  # noqa: ARG001 - read from the arguments by main
        bool, typer.Option("--verbose", "-v", help="Say more on standard error.")
    ] = False,
) -> None:
    if version:
        print(f"fuzzbee {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status and lets no exception out."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    app = build_app(decorated=sys.stdout.isatty())
    try:
        status = typer.main.get_command(app).main(
            args=arguments, prog_name="fuzzbee", standalone_mode=False
        )
    except InputError as error:
        return _fail(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return OK  # whoever read our output has seen enough
    except Exception as error:  # noqa: BLE001 - the last resort: one line, not a traceback
        if type(error).__name__ == "NoArgsIsHelpError":  # a group of verbs without a verb
            print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
            return BAD_INPUT
        if _is_usage_error(error):
            return _fail(error.format_message(), BAD_INPUT)  # type: ignore[attr-defined]
        if "-v" in arguments or "--verbose" in arguments:
            import traceback

            traceback.print_exc()
        return _fail(f"{type(error).__name__}: {error}", FAILED)
    return status if isinstance(status, int) else OK


def entry_point() -> None:
    """The ``fuzzbee`` command."""
    status = main()
    if any(thread.name.startswith("sink ") for thread in threading.enumerate()):
        # a sink that hangs (a stopped terminal) must not keep the process from ending
        os._exit(status)
    sys.exit(status)


def _is_usage_error(error: Exception) -> bool:
    """Whether the argument parser refused something; its classes moved between versions."""
    return hasattr(error, "format_message") and hasattr(error, "exit_code")


def _fail(text: str, status: int) -> int:
    print(f"fuzzbee: {' '.join(text.split())}", file=sys.stderr)
    return status
