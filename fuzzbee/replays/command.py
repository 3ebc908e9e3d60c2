"""``fuzzbee replay``: the filter over logs, or over the paper's signals, scored."""

from collections.abc import Iterable
from contextlib import closing, nullcontext
from functools import partial
from importlib.util import find_spec
from math import inf
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee import outputs
from fuzzbee.notify import print_line

if TYPE_CHECKING:
    from estimator.profile import Profile
    from fuzzbee.replays.trace import How, VehicleTrace
    from fuzzbee.viewer.viewer import ViewerSink

MOST_WRONG_DEG = 180.0
EXPORTS = ("csv", "mcap", "tum", "parquet")  # each written by its write_NAME
FOR_LOGS = (
    *("smooth", "retune", "skip", "start_wrong", "begin", "end", "columns"),
    *("mcap", "tum", "parquet", "view", "rrd"),
)
_SMOOTH = "The attitude that the whole log shows, not only what came before."

score = partial(opt.option, rich_help_panel="Score")


class ReplayOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    sources: list[str] = typer.Argument(
        metavar="LOG...|sim:", help="Log files, or sim: for the paper's signals."
    )
    begin: str | None = opt.BEGIN
    end: str | None = opt.END
    system_id: int | None = opt.SYSTEM_ID
    columns: Path | None = opt.source("What a CSV's columns are. [default: LOG.toml beside it]")
    seeds: str | None = opt.source("Noise seeds for sim:, both included.", metavar="A-B")
    profile: list[str] | None = opt.estimate(
        "paper, imu, adaptive or a TOML file; several. [default: imu; for sim: paper]",
        metavar="NAME|FILE",
        words=opt.PROFILES,
    )
    gain: float | None = opt.estimate("Fixed gain K instead of the fuzzy one.", metavar="K")
    start_wrong: float = opt.estimate(
        "Turn the first estimate by DEG degrees.", default=0.0, metavar="DEG"
    )
    retune: bool = opt.RETUNE
    smooth: bool = opt.estimate(_SMOOTH, default=False)
    reference: str | None = score(
        "sim (the truth) or autopilot. [default: sim if present]", metavar="sim|autopilot"
    )
    skip: float = score("Leave the first S seconds out of the errors.", default=0.0, metavar="S")
    csv: Path | None = opt.recording("Write every sample as CSV.")
    mcap: Path | None = opt.recording("Write them as MCAP, for Foxglove and others.")
    tum: Path | None = opt.recording("Write a TUM trajectory, for evo; the reference beside it.")
    parquet: Path | None = opt.recording("Write every sample as Parquet (needs pyarrow).")
    rrd: str | None = outputs.RRD
    plot: Path | None = opt.showing("Draw them: .png, .svg, .pdf or .html (zooms; extra: page).")
    view: str | None = outputs.VIEW
    as_json: bool = opt.JSON


@opt.command(
    "fuzzbee replay flight.tlog",
    "fuzzbee replay flight.tlog flight.bin --reference autopilot --skip 40 --json",
    "fuzzbee replay flight.tlog --plot flight.png --csv flight.csv",
    "fuzzbee replay flight.tlog --from arm --to disarm --plot flight.html",
    "fuzzbee replay flight.tlog --smooth --csv best.csv",
    "fuzzbee replay a.tlog b.bin --profile imu --profile mine.toml --plot both.pdf",
    "fuzzbee replay sim: --profile paper --seeds 0-19",
    "fuzzbee replay sim: --profile adaptive --seeds 0-99 --plot gain.pdf --csv gain.csv",
)
def replay(options: ReplayOptions) -> None:
    """Estimate over logs and score it against a reference."""
    from fuzzbee.arguments import gain_of

    if options.gain is not None:
        gain_of("--gain", options.gain)
    if not 0.0 <= options.skip < inf:
        raise InputError(f"--skip {options.skip:g}: must be a number of seconds, 0 or more")
    if not abs(options.start_wrong) <= MOST_WRONG_DEG:
        raise InputError(
            f"--start-wrong {options.start_wrong:g}: must be an angle in degrees, at most"
            f" {MOST_WRONG_DEG:g}"
        )
    if options.reference not in (None, "sim", "autopilot"):
        raise InputError(f"--reference {options.reference}: must be sim or autopilot")
    for source in options.sources:
        if source.startswith(opt.SIMULATION) and source != opt.SIMULATION:
            raise InputError(
                f"{source}: replay takes sim: (the paper's experiment) or a log;"
                " fuzzbee run URL --record FILE makes one of fuzzbee sim"
            )
    if opt.SIMULATION in options.sources:
        _replay_simulation(options)
    else:
        _replay_logs(options)


def _require_files(options: ReplayOptions, inputs: "Iterable[str | Path | None]") -> None:
    """Refuse what cannot be written, before any work."""
    from fuzzbee.replays.exports import reference_path
    from fuzzbee.replays.figure import require_plot

    written = opt.asked_for(options, *EXPORTS, "plot")
    beside = options.tum and reference_path(options.tum)
    files = [*written.items(), ("--rrd", options.rrd), ("--tum", beside)]
    outputs.require_own_files(files, inputs)
    for flag, path in written.items():
        if path.is_dir():
            raise InputError(f"{flag} {path}: is a folder")
        if not path.exists():
            try:
                TemporaryFile(dir=path.parent).close()
            except OSError as error:
                raise InputError(f"{flag} {path}: {error.strerror}") from None
    if options.mcap is not None:
        opt.require_extra("mcap", f"--mcap {options.mcap}", "mcap")
    if options.parquet is not None and find_spec("pyarrow") is None:
        raise InputError(f"--parquet {options.parquet}: needs pyarrow: pip install pyarrow")
    if options.plot is not None:
        require_plot(options.plot)


def _replay_logs(options: ReplayOptions) -> None:
    from estimator.profile import load_profile
    from fuzzbee.replays.table import reading_bar
    from fuzzbee.replays.trace import How

    if options.smooth and options.retune:
        raise InputError("--smooth looks at the whole log, --retune goes along it: one of both")
    if options.seeds is not None:
        raise InputError("--seeds goes with sim: only")
    names = [*dict.fromkeys(options.profile or ["imu"])]
    count = len(options.sources) * len(names)
    for flag, file in opt.asked_for(options, *EXPORTS, "view", "rrd").items():
        if count > 1:
            raise InputError(f"{flag} {file}: takes one log and one profile, not {count}")
    _require_files(options, [*options.sources, *names, options.columns])
    window = opt.time_window(options.begin, options.end)
    profiles = {name: load_profile(name) for name in names}
    way = (options.gain, options.system_id, options.start_wrong, options.retune, options.smooth)
    how = How(*way, options.columns, window, reading_bar, fits_built_in=not options.profile)
    viewer = outputs.open_viewer(options.view, options.rrd)
    with nullcontext() if viewer is None else closing(viewer):
        _report_logs(options, profiles, how, viewer)
        if viewer is not None:
            viewer.stay_open()


def _report_logs(
    options: ReplayOptions, profiles: "dict[str, Profile]", how: "How", viewer: "ViewerSink | None"
) -> None:
    import msgspec

    from fuzzbee.replays.plot import ComparisonPlot
    from fuzzbee.replays.score import report_log
    from fuzzbee.replays.table import print_reports

    runs = [(Path(source), name) for source in options.sources for name in profiles]
    lines: list[str] = []  # printed when all went well only: a refusal must be one single line
    figure, reports = ComparisonPlot(), []
    for path, name in runs:
        trace, report = report_log(path, profiles[name], how, options.reference, options.skip)
        if len(profiles) > 1:
            report = msgspec.structs.replace(report, profile=name)
        reports.append(report)
        who = path.name if len(profiles) == 1 else f"{path.name} with {name}"
        lines += [f"{who}: {line}" for line in trace.lines]
        if len(runs) == 1:
            _export(options, trace, viewer)
        elif options.plot is not None:
            figure.add(name, trace)
        del trace  # its columns go before the next log's come
    if len(runs) > 1 and options.plot is not None:
        figure.draw(options.plot)
    for line in lines:
        print_line(line)
    if options.as_json:
        result = reports[0] if len(reports) == 1 else {"logs": reports}
        print(msgspec.json.encode(result).decode())
    else:
        print_reports(reports)


def _export(options: ReplayOptions, trace: "VehicleTrace", viewer: "ViewerSink | None") -> None:
    from fuzzbee.replays import exports, plot

    for name in EXPORTS:
        if (path := getattr(options, name)) is not None:
            getattr(exports, f"write_{name}")(path, trace)
    if options.plot is not None:
        plot.draw(options.plot, trace)
    if viewer is not None:
        exports.show(viewer, trace)


def _replay_simulation(options: ReplayOptions) -> None:
    import msgspec

    from estimator.profile import load_profile
    from fuzzbee.replays import simulation
    from fuzzbee.replays.table import print_simulation

    if len(options.sources) > 1:
        raise InputError("replay: sim: stands alone, not beside logs")
    if len(options.profile or ()) > 1:
        raise InputError("replay: sim: takes one --profile")
    for flag in opt.asked_for(options, *FOR_LOGS):
        raise InputError(f"{flag} is for logs, not for sim:")
    _require_files(options, options.profile or ())
    name, seeds, gain = (options.profile or ["paper"])[0], options.seeds or "0", options.gain
    report, results = simulation.report_simulation(load_profile(name), opt.seed_range(seeds), gain)
    if options.csv is not None:
        simulation.write_csv(options.csv, results)
    if options.plot is not None:
        what = f"profile {Path(name).stem}" if gain is None else f"K = {gain:g}"
        title = f"The paper's experiment, {what}, noise seeds {seeds}"
        simulation.draw(title, options.plot, results)
    if options.as_json:
        print(msgspec.json.encode(report).decode())
    else:
        print_simulation(report)
