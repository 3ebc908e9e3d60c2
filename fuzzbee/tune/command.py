"""``fuzzbee tune``: find a profile's parameters by search, on the paper's signals or on logs."""

import typer

from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.options import command, examples, require_extra
from fuzzbee.tune.request import TuneRequest

EPILOG = examples(
    "fuzzbee tune sim: -o tuned.toml",
    "fuzzbee tune sim: -o tuned.toml --resume --view",
    "fuzzbee tune monday.tlog tuesday.tlog --hold-out wednesday.tlog -o copter.toml",
    "fuzzbee tune flight.bin -o copter.toml --objective recovery --plot figures",
    "fuzzbee tune sim: -o tuned.toml --cluster tcp://127.0.0.1:8786",
)


@command
def tune(request: TuneRequest) -> None:
    """Tune a profile with an artificial bee colony.

    The same options give the same file. Ctrl-C writes the best so far, and
    --resume goes on to the same result as an unbroken run. On logs a profile that gains nothing
    on what was held out is not written (exit status 1), unless with --force.
    """
    from fuzzbee.tune.plan import plan
    from fuzzbee.tune.run import run_plan
    from tuning.checkpoint import checkpoint_path

    _require_machine(request)
    if request.plot is not None:
        if request.plot.exists() and not request.plot.is_dir():
            raise InputError(f"--plot {request.plot}: not a folder")
        require_extra("matplotlib", "--plot", "plot")
    viewer = outputs.viewer_options(request.view, request.rrd)
    files = (request.output, checkpoint_path(request.output))
    written = [*(("--output", file) for file in files), ("--rrd", request.rrd)]
    outputs.require_own_files(written, [*request.sources, *request.held_out, request.base])
    status = run_plan(plan(request), request, viewer)
    if status:
        raise typer.Exit(status)


def _require_machine(request: TuneRequest) -> None:
    if request.threads is not None and request.threads < 1:
        raise InputError(f"--threads {request.threads}: at least 1 is needed")
    if request.cluster is not None and request.threads is not None:
        raise InputError("--threads and --cluster contradict each other: the workers compute")
