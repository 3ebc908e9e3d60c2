"""Replays for a person: one log as a list of figures, several as a table; a bar meanwhile."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from drivers.logs.log_file import LogFile
from fuzzbee.notify import printable
from fuzzbee.replays.comparison import REFERENCES
from fuzzbee.replays.schema import LogReport, SimulationReport
from fuzzbee.replays.score import ConstantTurn

# Fewer headings from magnetic north than this do not change a figure's last digit much.
LEAST_TOLD_SHARE = 0.01
MOST_DIFFERENCES = 10  # that are listed; --json has all


def print_reports(reports: Sequence[LogReport]) -> None:
    """Print a list of figures for one log, a table for several; both fit 80 columns."""
    console = Console()
    if len(reports) == 1:
        console.print(_figures(reports[0]))
    else:
        console.print(_table(reports))


def print_simulation(report: SimulationReport) -> None:
    """Print the figures of the paper's experiment."""
    grid = _grid()
    grid.add_row("seeds", f"{report.seeds[0]}-{report.seeds[1]}")
    grid.add_row("cost J", f"{report.cost:.3f}, mean over seeds")
    grid.add_row("steady error e", f"{report.steady_state_error:.5f}, mean over 4..14 s")
    grid.add_row("settled", f"{_number(report.settling_s)} s to e < 0.01, median")
    grid.add_row("gain K", f"{report.mean_gain:.2f}, mean")
    grid.add_row("took", f"{report.wall_s:.2f} s")
    Console().print(grid)


def _figures(report: LogReport) -> Table:
    imu, vehicle, errors, window = report.imu, report.vehicle, report.error_deg, report.window_s
    kind = " ".join(name.lower() for name in (vehicle.autopilot, vehicle.type) if name)
    samples = ", ".join(f"{count} {name}" for name, count in imu.messages.items())
    grid = _grid()
    grid.add_row("log", Text(printable(report.source)))
    if not isinstance(window, msgspec.UnsetType):
        grid.add_row("window", f"{window[0]:.1f} to {window[1]:.1f} s of the log")
    grid.add_row("vehicle", f"{vehicle.system_id} (component {vehicle.component_id}) {kind}")
    grid.add_row(
        "IMU",
        f"{samples} at {_number(imu.median_rate_hz, 1)} Hz (median; "
        f"{_number(imu.mean_rate_hz, 1)} really came a second) over "
        f"{report.duration_s:.0f} s; worst gap {_number(imu.worst_gap_s)} s "
        f"({_number(imu.worst_arrival_gap_s)} s between arrivals)",
    )
    if report.reference is None:
        grid.add_row("reference", "none in this log: nothing to compare with")
    else:
        word = "error" if report.reference == "sim" else "difference"
        truth = report.reference == "sim"
        note = "" if truth else ": the autopilot's own estimate, which is no truth"
        grid.add_row("reference", REFERENCES[report.reference] + note)
        grid.add_row(f"{word}, RMS", _errors_text(errors))
        grid.add_row("", f"inclination 95 %: {_number(errors.inclination_p95)}°")
        grid.add_row(
            "under sigma",
            f"inclination {_share(report.coverage.inclination)}, "
            f"heading {_share(report.coverage.heading)} (honest: 68 %); in motion "
            f"{_share(report.coverage.inclination_moving)}, "
            f"{_share(report.coverage.heading_moving)}",
        )
        if report.constant_turn is not None:
            grid.add_row("", _turn_text(report.constant_turn))
        if errors.heading_rms is not None and _magnetic_share(report) >= LEAST_TOLD_SHARE:
            grid.add_row("", _magnetic_text(report))
    for name, peer in report.peers.items():
        grid.add_row(f"{name}'s error", _errors_text(peer))
    for difference in report.differences[:MOST_DIFFERENCES]:
        grid.add_row("autopilot differs", spoken(msgspec.to_builtins(difference)))
    grid.add_row("under 5° after", f"{_number(report.convergence_s)} s")
    grid.add_row("gain K", f"{report.mean_gain:.2f}, mean")
    counts = ", ".join(f"{count} {reason}" for reason, count in report.rejected.items())
    grid.add_row("refused", counts or "nothing")
    grid.add_row("took", f"{report.wall_s:.2f} s")
    return grid


def spoken(difference: Mapping[str, Any]) -> str:
    """When the autopilot's attitude differed from ours, by how much, and who is likely wrong."""
    who = {"autopilot": "the autopilot's is likely wrong", "ours": "ours is likely wrong"}
    said = who.get(difference["wrong"], "nothing says which is wrong")
    return (
        f"{difference['begin_s']:.0f} to {difference['end_s']:.0f} s, inclination by up to "
        f"{difference['inclination_deg']:.0f}°, heading {difference['heading_deg']:.0f}°; {said}: "
        f"{difference['evidence']}"
    )


def _turn_text(turn: ConstantTurn) -> str:
    """What of the inclination's error would go with the mounting's or the trim's turn."""
    return (
        f"{turn.turn_deg:.1f}° of it is a constant turn: mounting or trim; inclination without "
        f"{turn.inclination_rms:.2f}°, {_share(turn.inclination_coverage)} under sigma"
    )


def _magnetic_share(report: LogReport) -> float:
    """The share of the scored samples whose heading is from magnetic north."""
    norths = report.heading_references
    return norths.get("magnetic", 0) / max(1, sum(norths.values()))


def _magnetic_text(report: LogReport) -> str:
    """Two norths in one comparison leave the declination in the heading's error."""
    whose = (
        "the truth's is from true north"
        if report.reference == "sim"
        else "an autopilot's is from true north once it has a position"
    )
    share = _share(_magnetic_share(report))
    return (
        f"{share} of our headings are from magnetic north, {whose}: there the place's "
        "declination stands in the heading's error"
    )


def _table(reports: Sequence[LogReport]) -> Table:
    """A row a replay; with the profiles named there is no room in 80 columns for all the rest."""
    table = Table(header_style="bold", caption="degrees RMS; p95 is of the inclination")
    has_profiles = any(report.profile for report in reports)
    table.add_column("log", overflow="fold", min_width=18)
    if has_profiles:
        table.add_column("profile", overflow="fold")
    names = ("against", "total", "head.", "incl.", "p95")
    for heading in names if has_profiles else ("Hz", "s", *names):
        table.add_column(heading, justify="right", no_wrap=True)
    for report in reports:
        errors = report.error_deg
        rate = (_number(report.imu.median_rate_hz, 1), f"{report.duration_s:.0f}")
        table.add_row(
            Text(printable(report.source.rpartition("/")[2])),
            *([Text(printable(report.profile))] if report.profile else rate),
            REFERENCES[report.reference] if report.reference else "none",
            _number(errors.total_rms),
            _number(errors.heading_rms),
            _number(errors.inclination_rms),
            _number(errors.inclination_p95),
        )
    return table


def _grid() -> Table:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="bold")
    grid.add_column()
    return grid


def _errors_text(errors: object) -> str:
    total, heading, inclination = (
        _number(getattr(errors, name)) for name in ("total_rms", "heading_rms", "inclination_rms")
    )
    return f"total {total}°, heading {heading}°, inclination {inclination}°"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.0f} %"


@contextmanager
def reading_bar(log: LogFile) -> Iterator[None]:
    """How far a log has been read, from its second piece on, where that goes to a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    name = TextColumn("{task.description}", markup=False)
    columns = (name, BarColumn(), DownloadColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        size = log.path.stat().st_size
        task = bar.add_task(printable(log.path.name), total=size, visible=False)

        def show(done_with: int) -> None:
            bar.update(task, completed=done_with, visible=done_with > 0)

        log.on_read = show
        try:
            yield
        finally:
            log.on_read = None
