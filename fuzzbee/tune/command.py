"""``fuzzbee tune``: find a profile's parameters by search, on the paper's signals or on logs."""

from pathlib import Path
from typing import NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee import outputs

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


class TuneRequest(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    sources: list[str] = typer.Argument(metavar="SOURCE...", help=_SOURCES)
    output: Path = opt.option("The profile to write.", "--output", "-o", default=...)
    base: str | None = opt.option(_BASE, metavar="PROFILE")
    objective: str | None = opt.option(_OBJECTIVE)
    reference: str | None = opt.option(_REFERENCE)
    hold_out: list[Path] | None = opt.option(_HOLD_OUT, metavar="LOG")
    begin: str | None = opt.BEGIN
    end: str | None = opt.END
    force: bool = opt.option("Write a profile also if it gains nothing held out.", default=False)
    algorithm: str = opt.option("abc, cmaes, de or random, on the same budget.", default="abc")
    food_sources: int | None = opt.option(_FOOD_SOURCES, "--sources", metavar="N")
    cycles: int | None = opt.option("Cycles. [default: 15; for sim: 300]", metavar="N")
    limit: int | None = opt.option(_LIMIT, metavar="N")
    seed: int = opt.option("Seed of the search.", default=0, metavar="N")
    parameters: str | None = opt.option(_PARAMETERS, metavar="GROUP,...")
    noise_seeds: str | None = opt.option("sim: seeds. [default: 100-107]", metavar="A-B")
    held_out_seeds: str | None = opt.option("sim: unseen seeds. [default: 200-219]", metavar="A-B")
    threads: int | None = opt.option("Processor cores to use. [default: all cores]", metavar="N")
    cluster: str | None = opt.option("Evaluate on this Dask scheduler.", metavar="ADDRESS")
    resume: bool = opt.option("Go on from FILE.checkpoint.", default=False)
    plot: Path | None = opt.option("Draw figures into this folder.", metavar="DIR")
    view: str | None = outputs.VIEW
    rrd: str | None = outputs.RRD
    as_json: bool = opt.JSON

    @property
    def is_simulated(self) -> bool:
        """Whether the paper's signals are searched on; else logs are."""
        return opt.SIMULATION in self.sources


@opt.command(
    "fuzzbee tune sim: -o tuned.toml",
    "fuzzbee tune sim: -o tuned.toml --resume --view",
    "fuzzbee tune monday.tlog tuesday.tlog --hold-out wednesday.tlog -o copter.toml",
    "fuzzbee tune flight.bin -o copter.toml --objective recovery --plot figures",
    "fuzzbee tune sim: -o tuned.toml --cluster tcp://127.0.0.1:8786",
)
def tune(request: TuneRequest) -> int:
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
        opt.require_extra("distributed", "--cluster", "cluster")
    if request.plot is not None:
        if request.plot.exists() and not request.plot.is_dir():
            raise InputError(f"--plot {request.plot}: not a folder")
        opt.require_extra("matplotlib", "--plot", "plot")
    outputs.require_viewer(request.view, request.rrd)
    files = (request.output, checkpoint_path(request.output))
    written = [*(("--output", file) for file in files), ("--rrd", request.rrd)]
    outputs.require_own_files(written, [*request.sources, *(request.hold_out or []), request.base])
    return run_plan(plan(request))
