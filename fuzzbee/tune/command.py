"""``fuzzbee tune``: find a profile's parameters by search, on the paper's signals or on logs."""

from pathlib import Path
from typing import Annotated

import typer

from estimator.errors import InputError, missing_extra
from fuzzbee import outputs
from fuzzbee.options import Json
from fuzzbee.say import say

EPILOG = """Examples:

  fuzzbee tune sim: -o tuned.toml

  fuzzbee tune sim: -o tuned.toml --resume --view

  fuzzbee tune monday.tlog tuesday.tlog --hold-out wednesday.tlog -o copter.toml

  fuzzbee tune flight.bin -o copter.toml --objective recovery --plot figures

  fuzzbee tune sim: -o tuned.toml --cluster tcp://127.0.0.1:8786"""


def tune(
    sources: Annotated[
        list[str],
        typer.Argument(metavar="SOURCE...", help="Log files, or sim: for the paper's signals."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The profile to write.")
    ],
    base: Annotated[
        str | None,
        typer.Option(
            "--base",
            metavar="PROFILE",
            help="Where to start: paper, imu or a TOML file."
            " [default: imu; for sim: the middle of the paper's bounds]",
        ),
    ] = None,
    objective: Annotated[
        str | None,
        typer.Option(
            "--objective",
            help="Logs: flight, the errors that one sees; recovery, the paper's J from wrong"
            " starts. [default: flight]",
        ),
    ] = None,
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--hold-out",
            metavar="LOG",
            help="A log to judge by, not to search on; repeatable. [default: every third log;"
            " of one log its later part]",
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write a profile also if it gains nothing held out.")
    ] = False,
    algorithm: Annotated[
        str, typer.Option("--algorithm", help="abc, cmaes, de or random, on the same budget.")
    ] = "abc",
    food_sources: Annotated[
        int | None,
        typer.Option(
            "--sources",
            metavar="N",
            help="Food sources, half of the colony. [default: 10; for sim: 100]",
        ),
    ] = None,
    cycles: Annotated[
        int | None,
        typer.Option("--cycles", metavar="N", help="Cycles. [default: 15; for sim: 300]"),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            "--limit",
            metavar="N",
            help="Failures after which a food source is left. [default: sources x parameters]",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Seed of the search.")] = 0,
    parameters: Annotated[
        str | None,
        typer.Option(
            "--parameters",
            metavar="GROUP,...",
            help="membership, filter; for logs also noise, gain, confidence, conditioning."
            " [default: by source, objective and rate]",
        ),
    ] = None,
    noise_seeds: Annotated[
        str | None,
        typer.Option("--noise-seeds", metavar="A-B", help="sim: seeds. [default: 100-107]"),
    ] = None,
    held_out_seeds: Annotated[
        str | None,
        typer.Option(
            "--held-out-seeds", metavar="A-B", help="sim: unseen seeds. [default: 200-219]"
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option("--threads", metavar="N", help="Processor cores to use. [default: all cores]"),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="ADDRESS", help="Evaluate on this Dask scheduler."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from FILE.checkpoint.")] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="DIR", help="Draw figures into this folder.")
    ] = None,
    view: outputs.View = None,
    rrd: outputs.Rrd = None,
    as_json: Json = False,
) -> None:
    """Find a profile's parameters with an artificial bee colony, on logs or on the paper's signals.

    The same options give the same file. Ctrl-C writes the best so far, and
    --resume goes on to the same result as an unbroken run. On logs a profile that gains nothing
    on what was held out is not written (exit status 1), unless with --force.
    """
    from fuzzbee.tune.plan import TuneRequest, plan
    from fuzzbee.tune.run import run_plan

    request = TuneRequest(
        sources=tuple(sources),
        output=output,
        base=base,
        objective=objective,
        hold_out=tuple(hold_out or ()),
        algorithm=algorithm,
        food_sources=food_sources,
        cycles=cycles,
        limit=limit,
        seed=seed,
        parameters=parameters,
        noise_seeds=noise_seeds,
        held_out_seeds=held_out_seeds,
    )
    if threads is not None and threads < 1:
        raise InputError(f"--threads {threads}: at least 1 is needed")
    if cluster is not None and threads is not None:
        raise InputError("--threads and --cluster contradict each other: the workers compute")
    if plot is not None:
        _require_plots(plot)
    viewer = outputs.viewer_options(view, rrd)
    outputs.require_own_file(rrd, [*sources, output])
    status = run_plan(
        plan(request, tell),
        threads=threads,
        cluster=cluster,
        resume=resume,
        force=force,
        plot=plot,
        viewer=viewer,
        as_json=as_json,
    )
    if status:
        raise typer.Exit(status)


def tell(line: str) -> None:
    """One line for a person, on standard error."""
    say(line, "")


def _require_plots(folder: Path) -> None:
    """Refuse, before the search, a folder or a library that drawing would miss after it."""
    from importlib.util import find_spec

    if folder.exists() and not folder.is_dir():
        raise InputError(f"--plot {folder}: not a folder")
    if find_spec("matplotlib") is None:
        raise missing_extra("--plot", "plot")
