"""``fuzzbee tune``: find a profile's parameters by search, on the paper's signals or on logs."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.options import From, Json, To, command, examples, option, require_extra

SIMULATION = "sim:"

_SOURCES = "Log files, or sim: for the paper's signals."
_BASE = (
    "Where to start: paper, imu or a TOML file."
    " [default: imu; for sim: the middle of the paper's bounds]"
)
_OBJECTIVE = (
    "Logs: flight, the errors that one sees; coverage, of what moves sigma alone;"
    " recovery, the paper's J from wrong starts. [default: flight]"
)
_REFERENCE = (
    "Logs: sim, smooth (by the whole log) or autopilot."
    " [default: sim, else smooth if it is sure, else autopilot]"
)
_HOLD_OUT = (
    "A log to judge by, not to search on; repeatable."
    " [default: every third log; of one log its later part]"
)
_FOOD_SOURCES = "Food sources, half of the colony. [default: 10; for sim: 100]"
_LIMIT = "Failures after which a food source is left. [default: sources x parameters]"
_PARAMETERS = (
    "membership, filter; for logs also noise, sigma, gain, confidence, conditioning, calibration."
    " [default: by source, objective and rate]"
)
_NOISE_SEEDS = "sim: seeds. [default: 100-107]"
_HELD_OUT_SEEDS = "sim: unseen seeds. [default: 200-219]"
_THREADS = "Processor cores to use. [default: all cores]"

EPILOG = examples(
    "fuzzbee tune sim: -o tuned.toml",
    "fuzzbee tune sim: -o tuned.toml --resume --view",
    "fuzzbee tune monday.tlog tuesday.tlog --hold-out wednesday.tlog -o copter.toml",
    "fuzzbee tune flight.bin -o copter.toml --objective recovery --plot figures",
    "fuzzbee tune sim: -o tuned.toml --cluster tcp://127.0.0.1:8786",
)


class TuneRequest(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    sources: Annotated[list[str], typer.Argument(metavar="SOURCE...", help=_SOURCES)]
    output: Annotated[Path, option("The profile to write.", "--output", "-o", metavar="FILE")]
    base: Annotated[str | None, option(_BASE, metavar="PROFILE")] = None
    objective: Annotated[str | None, option(_OBJECTIVE)] = None
    reference: Annotated[str | None, option(_REFERENCE)] = None
    hold_out: Annotated[list[Path] | None, option(_HOLD_OUT, metavar="LOG")] = None
    begin: From = None
    end: To = None
    force: Annotated[bool, option("Write a profile also if it gains nothing held out.")] = False
    algorithm: Annotated[str, option("abc, cmaes, de or random, on the same budget.")] = "abc"
    food_sources: Annotated[int | None, option(_FOOD_SOURCES, "--sources", metavar="N")] = None
    cycles: Annotated[int | None, option("Cycles. [default: 15; for sim: 300]", metavar="N")] = None
    limit: Annotated[int | None, option(_LIMIT, metavar="N")] = None
    seed: Annotated[int, option("Seed of the search.", metavar="N")] = 0
    parameters: Annotated[str | None, option(_PARAMETERS, metavar="GROUP,...")] = None
    noise_seeds: Annotated[str | None, option(_NOISE_SEEDS, metavar="A-B")] = None
    held_out_seeds: Annotated[str | None, option(_HELD_OUT_SEEDS, metavar="A-B")] = None
    threads: Annotated[int | None, option(_THREADS, metavar="N")] = None
    cluster: Annotated[
        str | None, option("Evaluate on this Dask scheduler.", metavar="ADDRESS")
    ] = None
    resume: Annotated[bool, option("Go on from FILE.checkpoint.")] = False
    plot: Annotated[Path | None, option("Draw figures into this folder.", metavar="DIR")] = None
    view: outputs.View = None
    rrd: outputs.Rrd = None
    as_json: Json = False

    @property
    def is_simulated(self) -> bool:
        """Whether the paper's signals are searched on; else logs are."""
        return SIMULATION in self.sources


@command
def tune(request: TuneRequest) -> None:
    """Tune a profile with an artificial bee colony.

    The same options give the same file. Ctrl-C writes the best so far, and
    --resume goes on to the same result as an unbroken run. On logs a profile that gains nothing
    on what was held out is not written (exit status 1), unless with --force.
    """
    from fuzzbee.tune.plan import plan
    from fuzzbee.tune.run import run_plan
    from tuning.search import checkpoint_path

    if request.cluster is not None and request.threads is not None:
        raise InputError("--threads and --cluster contradict each other: the workers compute")
    if request.cluster is not None:
        require_extra("distributed", "--cluster", "cluster")
    if request.plot is not None:
        if request.plot.exists() and not request.plot.is_dir():
            raise InputError(f"--plot {request.plot}: not a folder")
        require_extra("matplotlib", "--plot", "plot")
    viewer = outputs.viewer_options(request.view, request.rrd)
    files = (request.output, checkpoint_path(request.output))
    written = [*(("--output", file) for file in files), ("--rrd", request.rrd)]
    outputs.require_own_files(written, [*request.sources, *(request.hold_out or []), request.base])
    status = run_plan(plan(request), viewer)
    if status:
        raise typer.Exit(status)
