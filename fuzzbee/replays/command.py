"""``fuzzbee replay``: the filter over logs, or over the paper's signals, scored."""

import time
from collections.abc import Callable, Iterable
from functools import partial
from importlib.util import find_spec
from math import inf
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from drivers.logs.time_window import TimeWindow
from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.notify import tell
from fuzzbee.options import (
    PROFILES,
    From,
    Retune,
    To,
    command,
    examples,
    of_estimate,
    of_recording,
    of_showing,
    of_source,
    option,
    require_extra,
    require_gain,
    seed_range,
    time_window,
)

if TYPE_CHECKING:
    from estimator.profile import Profile
    from fuzzbee.replays.log_report import Export
    from fuzzbee.replays.trace import VehicleTrace

SIMULATION = "sim:"
MOST_WRONG_DEG = 180.0
_SOURCES = "Log files, or sim: for the paper's signals."
of_score = partial(option, panel="Score")
_PROFILE = "paper, imu, adaptive or a TOML file; several. [default: imu; for sim: paper]"
_SKIP = "Leave the first S seconds out of the errors."
_START_WRONG = "Turn the first estimate by DEG degrees."
_REFERENCE = "sim (the truth) or autopilot. [default: sim if present]"
_SYSTEM_ID = "Which vehicle. [default: the one with most IMU samples]"
_GAIN = "Fixed gain K instead of the fuzzy one."
_SEEDS = "Noise seeds for sim:, both included."
_SMOOTH = "The attitude that the whole log tells, not only what came before."
_COLUMNS = "What a CSV's columns are. [default: LOG.toml beside it]"
_TUM = "Write a TUM trajectory, for evo; the reference beside it."
_PLOT = "Draw them: .png, .svg, .pdf or .html (zooms; extra: page)."
_PARQUET = "Write every sample as Parquet (needs pyarrow)."
_MCAP = "Write them as MCAP, for Foxglove and others."

EPILOG = examples(
    "fuzzbee replay flight.tlog",
    "fuzzbee replay flight.tlog flight.bin --reference autopilot --skip 40 --json",
    "fuzzbee replay flight.tlog --plot flight.png --csv flight.csv",
    "fuzzbee replay flight.tlog --from arm --to disarm --plot flight.html",
    "fuzzbee replay flight.tlog --smooth --csv best.csv",
    "fuzzbee replay a.tlog b.bin --profile imu --profile mine.toml --plot both.pdf",
    "fuzzbee replay sim: --profile paper --seeds 0-19",
    "fuzzbee replay sim: --profile adaptive --seeds 0-99 --plot gain.pdf --csv gain.csv",
)


class ReplayOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    sources: Annotated[list[str], typer.Argument(metavar="LOG...|sim:", help=_SOURCES)]
    begin: From = None
    end: To = None
    system_id: Annotated[int | None, of_source(_SYSTEM_ID, metavar="ID")] = None
    columns: Annotated[Path | None, of_source(_COLUMNS, metavar="FILE")] = None
    seeds: Annotated[str | None, of_source(_SEEDS, metavar="A-B")] = None
    profile: Annotated[
        list[str] | None, of_estimate(_PROFILE, metavar="NAME|FILE", words=PROFILES)
    ] = None
    gain: Annotated[float | None, of_estimate(_GAIN, metavar="K")] = None
    start_wrong: Annotated[float, of_estimate(_START_WRONG, metavar="DEG")] = 0.0
    retune: Retune = False
    smooth: Annotated[bool, of_estimate(_SMOOTH)] = False
    reference: Annotated[str | None, of_score(_REFERENCE, metavar="sim|autopilot")] = None
    skip: Annotated[float, of_score(_SKIP, metavar="S")] = 0.0
    csv: Annotated[Path | None, of_recording("Write every sample as CSV.", metavar="FILE")] = None
    mcap: Annotated[Path | None, of_recording(_MCAP, metavar="FILE")] = None
    tum: Annotated[Path | None, of_recording(_TUM, metavar="FILE")] = None
    parquet: Annotated[Path | None, of_recording(_PARQUET, metavar="FILE")] = None
    rrd: outputs.Rrd = None
    plot: Annotated[Path | None, of_showing(_PLOT, metavar="FILE")] = None
    view: outputs.View = None
    as_json: Annotated[bool, of_showing("One JSON object on standard output.", "--json")] = False

    def given(self, *names: str) -> "Iterable[tuple[str, object]]":
        """Name on the command line and value of those of these options that were given."""
        pairs = ((name, getattr(self, name)) for name in names)
        return [(f"--{name.replace('_', '-')}", value) for name, value in pairs if value]


@command
def replay(options: ReplayOptions) -> None:
    """Estimate over logs and score it against a reference."""
    _require_numbers(options)
    if SIMULATION in options.sources:
        _require_simulation(options)
        _replay_simulation(options)
        return
    if options.smooth and options.retune:
        raise InputError("--smooth looks at the whole log, --retune goes along it: one of both")
    if options.seeds is not None:
        raise InputError("--seeds goes with sim: only")
    _replay_logs(options)


def _require_numbers(options: ReplayOptions) -> None:
    require_gain(options.gain)
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
        if source.startswith(SIMULATION) and source != SIMULATION:
            raise InputError(
                f"{source}: replay takes sim: (the paper's experiment) or a log;"
                " fuzzbee run URL --record FILE makes one of fuzzbee sim"
            )


def _require_simulation(options: ReplayOptions) -> None:
    """Refuse what is for logs."""
    if len(options.sources) > 1:
        raise InputError("replay: sim: stands alone, not beside logs")
    if len(options.profile or ()) > 1:
        raise InputError("replay: sim: takes one --profile")
    if options.smooth:
        raise InputError("--smooth is for logs")
    if options.retune:
        raise InputError("--retune is for logs: the paper's experiment ends after 15 s")
    for name, _ in options.given("skip", "start_wrong"):
        raise InputError(f"{name} is for logs; sim: starts wrong by itself")
    for name, given in (("--from", options.begin), ("--to", options.end)):
        if given is not None:
            raise InputError(f"{name} is for logs, not for sim:")
    for name, _ in options.given("mcap", "tum", "parquet", "view", "rrd", "columns"):
        raise InputError(f"{name} is for logs, not for sim:")


def _require_writable(options: ReplayOptions) -> None:
    """Refuse before the replay what could not be written after it."""
    for name, file in options.given("csv", "mcap", "tum", "parquet", "plot"):
        path = Path(str(file))
        if path.is_dir():
            raise InputError(f"{name} {path}: is a folder")
        if not path.exists():
            try:
                TemporaryFile(dir=path.parent).close()
            except OSError as error:
                raise InputError(f"{name} {path}: {error.strerror}") from None


def _replay_logs(options: ReplayOptions) -> None:
    from estimator.profile import load_profile

    names, window = options.profile or ["imu"], time_window(options.begin, options.end)
    runs = len(options.sources) * len(names)
    if runs > 1:
        for name, file in options.given("csv", "mcap", "tum", "parquet", "view", "rrd"):
            raise InputError(f"{name} {file}: takes one log and one profile, not {runs}")
    written = list(options.given("csv", "mcap", "tum", "parquet", "plot", "rrd"))
    if options.tum is not None:
        from fuzzbee.replays.exports import reference_path

        written.append(("--tum", reference_path(options.tum)))
    outputs.require_own_files(written, [*options.sources, *names, options.columns])
    _require_writable(options)
    exports = _exports(options)
    profiles = {name: load_profile(name) for name in names}
    viewer = outputs.open_viewer(options.view, options.rrd)
    try:
        if viewer is not None:
            from fuzzbee.replays.exports import show

            exports.append(partial(show, viewer))
        _report_logs(options, profiles, window, exports)
        if viewer is not None:
            viewer.stay_open()
    finally:
        if viewer is not None:
            viewer.close()


def _report_logs(
    options: ReplayOptions,
    profiles: "dict[str, Profile]",
    window: TimeWindow,
    exports: "list[Export]",
) -> None:
    import msgspec

    from fuzzbee.replays.log_report import report_log
    from fuzzbee.replays.plot import ComparisonPlot
    from fuzzbee.replays.table import print_reports, reading_bar
    from fuzzbee.replays.trace import How

    told: list[str] = []  # printed when all went well only: a refusal must be one single line
    runs = [(Path(source), name) for source in options.sources for name in profiles]
    figure = ComparisonPlot() if options.plot and len(runs) > 1 else None
    chosen = [
        profiles[name] if options.profile else _fitting(path, profiles[name], options)
        for path, name in runs
    ]
    how = How(
        options.gain,
        options.system_id,
        options.start_wrong,
        options.retune,
        options.smooth,
        options.columns,
        window,
    )
    reports = [
        report_log(
            path,
            profile,
            how,
            reference=options.reference,
            skip_s=options.skip,
            tell=told.append,
            profile_name=name if len(profiles) > 1 else None,
            reading=reading_bar,
            exports=[*exports, partial(figure.add, path.name, name)] if figure else exports,
        )
        for (path, name), profile in zip(runs, chosen, strict=True)
    ]
    if figure is not None and options.plot is not None:
        figure.draw(options.plot)
    for line in told:
        tell(line)
    if options.as_json:
        result = reports[0] if len(reports) == 1 else {"logs": reports}
        print(msgspec.json.encode(result).decode())
    else:
        print_reports(reports)


def _fitting(path: Path, usual: "Profile", options: ReplayOptions) -> "Profile":
    """The profile of a log for which none was chosen: fuzzbee's own vehicle says which fits."""
    from drivers.logs.open import built_in_motion, open_log
    from drivers.simulation.simulated_vehicle import PROFILES
    from estimator.profile import load_profile

    with open_log(path, options.columns) as log:
        name = PROFILES.get(built_in_motion(log) or "")
    return usual if name is None else load_profile(name)


def _exports(options: ReplayOptions) -> "list[Export]":
    """The files to write; what cannot be written is refused before the replay."""
    from fuzzbee.replays import exports, mcap_file, plot
    from fuzzbee.replays.figure import require_plot

    if options.mcap is not None:
        require_extra("mcap", f"--mcap {options.mcap}", "mcap")
    if options.parquet is not None and find_spec("pyarrow") is None:
        raise InputError(f"--parquet {options.parquet}: needs pyarrow: pip install pyarrow")
    if options.plot is not None:
        require_plot(options.plot)
    writers: dict[str, Callable[[Any, VehicleTrace], None]] = {
        "csv": lambda path, trace: exports.write_csv(path, exports.columns(trace)),
        "mcap": mcap_file.write_mcap,
        "tum": exports.write_tum,
        "parquet": lambda path, trace: exports.write_parquet(path, exports.columns(trace)),
    }
    if len(options.sources) * len(options.profile or [""]) == 1:  # several are one figure
        writers["plot"] = partial(plot.draw, Path(options.sources[0]).name)
    return [
        partial(write, getattr(options, name))
        for name, write in writers.items()
        if getattr(options, name) is not None
    ]


def _replay_simulation(options: ReplayOptions) -> None:
    import msgspec

    from estimator.profile import load_profile
    from fuzzbee.replays import simulation
    from fuzzbee.replays.exports import write_csv
    from fuzzbee.replays.figure import require_plot
    from fuzzbee.replays.table import print_simulation

    started = time.perf_counter()
    outputs.require_own_files(options.given("csv", "plot"), options.profile or ())
    _require_writable(options)
    name, seeds, gain = (options.profile or ["paper"])[0], options.seeds or "0", options.gain
    exports: list[simulation.Export] = []
    if options.csv is not None:
        csv = options.csv
        exports.append(lambda *made: write_csv(csv, simulation.columns(*made)))
    if options.plot is not None:
        require_plot(options.plot)
        what = f"profile {Path(name).stem}" if gain is None else f"K = {gain:g}"
        title = f"The paper's experiment, {what}, noise seeds {seeds}"
        exports.append(partial(simulation.draw, options.plot, title))
    report = simulation.report_simulation(load_profile(name), seed_range(seeds), gain, exports)
    report = msgspec.structs.replace(report, wall_s=time.perf_counter() - started)
    if options.as_json:
        print(msgspec.json.encode(report).decode())
    else:
        print_simulation(report)
