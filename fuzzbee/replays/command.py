"""``fuzzbee replay``: the filter over logs, or over the paper's signals, scored."""

import time
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.options import require_gain
from fuzzbee.say import say

if TYPE_CHECKING:
    from estimator.profile import Profile
    from fuzzbee.replays.log_report import Export
    from fuzzbee.replays.simulation_report import Export as SimulationExport

SIMULATION = "sim:"

EPILOG = """Examples:

  fuzzbee replay flight.tlog

  fuzzbee replay flight.tlog flight.bin --reference autopilot --skip 40 --json

  fuzzbee replay flight.tlog --plot flight.png --csv flight.csv

  fuzzbee replay sim: --profile paper --seeds 0-19

  fuzzbee replay sim: --profile adaptive --seeds 0-99 --plot gain.pdf --csv gain.csv"""


def replay(
    sources: Annotated[
        list[str],
        typer.Argument(metavar="LOG...|sim:", help="Log files, or sim: for the paper's signals."),
    ],
    profile: Annotated[
        str | None,
        typer.Option(
            "--profile", help="paper, imu, adaptive or a TOML file. [default: imu; for sim: paper]"
        ),
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option("--gain", metavar="K", help="Fixed gain K instead of the fuzzy one."),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option("--reference", help="sim or autopilot. [default: sim if present]"),
    ] = None,
    skip: Annotated[
        float,
        typer.Option("--skip", metavar="S", help="Leave the first S seconds out of the errors."),
    ] = 0.0,
    start_wrong: Annotated[
        float,
        typer.Option(
            "--start-wrong", metavar="DEG", help="Turn the first estimate by DEG degrees."
        ),
    ] = 0.0,
    system_id: Annotated[
        int | None,
        typer.Option("--system-id", help="Which vehicle. [default: the one with most IMU samples]"),
    ] = None,
    retune: Annotated[
        bool,
        typer.Option("--retune", help="Retune a few numbers whenever the sensors' noise changes."),
    ] = False,
    seeds: Annotated[
        str | None,
        typer.Option("--seeds", metavar="A-B", help="Noise seeds for sim:, both included."),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="Write every sample as CSV."),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option("--mcap", metavar="FILE", help="Write them as MCAP, for Foxglove and others."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="Draw them: .png, .svg or .pdf."),
    ] = None,
    view: outputs.View = None,
    rrd: outputs.Rrd = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on standard output.")
    ] = False,
) -> None:
    """Run the filter over logs as fast as it goes and score it against a reference."""
    require_gain(gain)
    if not 0.0 <= skip < inf:
        raise InputError(f"--skip {skip:g}: must be a number of seconds, 0 or more")
    if not isfinite(start_wrong):
        raise InputError(f"--start-wrong {start_wrong:g}: must be an angle in degrees")
    if reference not in (None, "sim", "autopilot"):
        raise InputError(f"--reference {reference}: must be sim or autopilot")
    for source in sources:
        if source.startswith(SIMULATION) and source != SIMULATION:
            raise InputError(
                f"{source}: replay takes sim: (the paper's experiment) or a log;"
                " fuzzbee run URL --record FILE makes one of fuzzbee sim"
            )
    if SIMULATION in sources:
        if len(sources) > 1:
            raise InputError("replay: sim: stands alone, not beside logs")
        if retune:
            raise InputError("--retune is for logs: the paper's experiment ends after 15 s")
        for option, value in (("--skip", skip), ("--start-wrong", start_wrong)):
            if value:
                raise InputError(f"{option} is for logs; sim: starts wrong by itself")
        for option, file in (("--mcap", mcap), ("--view", view), ("--rrd", rrd)):
            if file is not None:
                raise InputError(f"{option} is for logs, not for sim:")
        _replay_simulation(profile or "paper", gain, seeds or "0", csv, plot, as_json=as_json)
        return
    if seeds is not None:
        raise InputError("--seeds goes with sim: only")
    options: dict[str, Any] = {
        "fixed_gain": gain,
        "reference": reference,
        "skip_s": skip,
        "start_wrong_deg": start_wrong,
        "system_id": system_id,
        "retune": retune,
        "exports": _exports(sources, csv, mcap, plot),
    }
    if len(sources) > 1:
        for option, target in (("--view", view), ("--rrd", rrd)):
            if target is not None:
                raise InputError(f"{option} takes one log, not {len(sources)}")
    from estimator.profile import load_profile

    chosen = load_profile(profile or "imu")
    outputs.require_own_file(rrd, sources)
    viewer = outputs.open_viewer(view, rrd, chosen)
    if viewer is not None:
        from functools import partial

        from fuzzbee.replays.viewer_replay import show

        options["exports"].append(partial(show, viewer))
    try:
        paths = [Path(source) for source in sources]
        profiles = [chosen if profile else _fitting(path, chosen) for path in paths]
        _replay_logs(paths, profiles, options, as_json=as_json)
        if viewer is not None:
            viewer.stream.stay_open()
    finally:
        if viewer is not None:
            viewer.close()


def _fitting(path: Path, usual: "Profile") -> "Profile":
    """The profile of a log for which none was chosen: fuzzbee's own vehicle says which fits."""
    from drivers.logs.open import built_in_motion, open_log
    from drivers.simulation.simulated_vehicle import PROFILES
    from estimator.profile import load_profile

    with open_log(path) as log:
        name = PROFILES.get(built_in_motion(log) or "")
    return usual if name is None else load_profile(name)


def _replay_logs(
    paths: list[Path], profiles: "list[Profile]", options: dict[str, Any], *, as_json: bool
) -> None:
    import msgspec

    from fuzzbee.replays.log_report import report_log
    from fuzzbee.replays.table import print_reports

    told: list[str] = []  # printed when all went well only: a refusal must be one single line
    reports = [
        report_log(path, profile, tell=told.append, **options)
        for path, profile in zip(paths, profiles, strict=True)
    ]
    for line in told:
        _tell(line)
    if not as_json:
        print_reports(reports)
    elif len(reports) == 1:
        print(msgspec.json.encode(reports[0]).decode())
    else:
        print(msgspec.json.encode({"logs": reports}).decode())


def _exports(
    sources: list[str], csv: Path | None, mcap: Path | None, plot: Path | None
) -> "list[Export]":
    """The files to write; what cannot be written is refused before the replay.

    Raises:
        InputError: several logs for one file, a suffix that is none, a missing library.
    """
    from functools import partial

    from fuzzbee.replays import exports, mcap_file
    from fuzzbee.replays import plot as replay_plot

    chosen: list[Export] = []
    for option, file in (("--csv", csv), ("--mcap", mcap), ("--plot", plot)):
        if file is not None and len(sources) > 1:
            raise InputError(f"{option} {file}: takes one log, not {len(sources)}")
    if csv is not None:
        chosen.append(partial(exports.write_csv, csv))
    if mcap is not None:
        mcap_file.require_mcap(mcap)
        chosen.append(partial(mcap_file.write_mcap, mcap))
    if plot is not None:
        replay_plot.require_plot(plot)
        title = Path(sources[0]).name
        chosen.append(partial(replay_plot.draw, plot, title))
    return chosen


def _replay_simulation(
    profile_name: str,
    gain: float | None,
    seeds: str,
    csv: Path | None,
    plot: Path | None,
    *,
    as_json: bool,
) -> None:
    import msgspec

    from estimator.profile import load_profile
    from fuzzbee.replays.simulation_report import report_simulation
    from fuzzbee.replays.table import print_simulation

    started = time.perf_counter()
    exports = _simulation_exports(profile_name, gain, seeds, csv, plot)
    report = report_simulation(load_profile(profile_name), seed_range(seeds), gain, exports)
    report = msgspec.structs.replace(report, wall_s=time.perf_counter() - started)
    if as_json:
        print(msgspec.json.encode(report).decode())
    else:
        print_simulation(report)


def _simulation_exports(
    profile_name: str, gain: float | None, seeds: str, csv: Path | None, plot: Path | None
) -> "list[SimulationExport]":
    """The files to write of the experiment; what cannot be written is refused before it runs."""
    from functools import partial

    from fuzzbee.replays import simulation_files
    from fuzzbee.replays.plot import require_plot

    chosen: list[SimulationExport] = []
    if csv is not None:
        chosen.append(partial(simulation_files.write_csv, csv))
    if plot is not None:
        require_plot(plot)
        what = f"profile {Path(profile_name).stem}" if gain is None else f"K = {gain:g}"
        title = f"The paper's experiment, {what}, noise seeds {seeds}"
        chosen.append(partial(simulation_files.draw, plot, title))
    return chosen


def seed_range(text: str) -> range:
    """``A-B``, both included, or a single ``A``.

    Raises:
        InputError: not of that form, or empty.
    """
    first, _, last = text.partition("-")
    if not first.isdecimal() or not (last or first).isdecimal():
        raise InputError(f"--seeds {text}: must be A-B with whole numbers, such as 0-19")
    seeds = range(int(first), int(last or first) + 1)
    if not seeds:
        raise InputError(f"--seeds {text}: the range is empty")
    return seeds


def _tell(line: str) -> None:
    say(line, "")
