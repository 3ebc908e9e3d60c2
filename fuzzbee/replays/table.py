"""Replays for a person: one log as a list of figures, several as a table; a bar meanwhile."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import msgspec
from msgspec.structs import astuple
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

from drivers.logs.log_file import LogFile
from fuzzbee.notify import printable
from fuzzbee.replays import report as schema

# Fewer headings from magnetic north than this do not change a figure's last digit much.
LEAST_SHOWN_SHARE = 0.01
MOST_DIFFERENCES = 10  # that are listed; --json has all


def print_reports(reports: Sequence[schema.LogReport]) -> None:
    """Print a list of figures for one log, a table for several; both fit 80 columns."""
    if len(reports) == 1:
        _print_grid([*_figures(reports[0]), *_after(reports[0])])
        return
    table = Table(header_style="bold", caption="degrees RMS; p95 is of the inclination")
    has_profiles = any(report.profile for report in reports)
    table.add_column("log", overflow="fold", min_width=18)
    if has_profiles:
        table.add_column("profile", overflow="fold")
    names = ("against", "total", "head.", "incl.", "p95")
    for heading in names if has_profiles else ("Hz", "s", *names):  # no room for both
        table.add_column(heading, justify="right", no_wrap=True)
    for report in reports:
        rate = (_number(report.imu.median_rate_hz, 1), f"{report.duration_s:.0f}")
        table.add_row(
            Text(printable(report.source.rpartition("/")[2])),
            *([Text(printable(report.profile))] if report.profile else rate),
            schema.REFERENCES[report.reference] if report.reference else "none",
            *map(_number, astuple(report.error_deg)),
        )
    Console().print(table)


def print_simulation(report: schema.SimulationReport) -> None:
    """Print the figures of the paper's experiment."""
    figures = {
        "seeds": f"{report.seeds[0]}-{report.seeds[1]}",
        "cost J": f"{report.cost:.3f}, mean over seeds",
        "steady error e": f"{report.steady_state_error:.5f}, mean over 4..14 s",
        "settled": f"{_number(report.settling_s)} s to e < 0.01, median",
        "gain K": f"{report.mean_gain:.2f}, mean",
        "took": f"{report.wall_s:.2f} s",
    }
    _print_grid(figures.items())


def _print_grid(rows: Iterable[tuple[str, str]]) -> None:
    grid = Table.grid(Column(style="bold"), Column(), padding=(0, 2))
    for name, text in rows:
        grid.add_row(name, Text(text))
    Console().print(grid)


def _figures(report: schema.LogReport) -> Iterator[tuple[str, str]]:
    """Whose log it is, and how near the estimate is to the reference."""
    imu, vehicle, errors, window = report.imu, report.vehicle, report.error_deg, report.window_s
    kind = " ".join(name.lower() for name in (vehicle.autopilot, vehicle.type) if name)
    samples = ", ".join(f"{count} {name}" for name, count in imu.messages.items())
    yield "log", printable(report.source)
    if not isinstance(window, msgspec.UnsetType):
        yield "window", f"{window[0]:.1f} to {window[1]:.1f} s of the log"
    yield "vehicle", f"{vehicle.system_id} (component {vehicle.component_id}) {kind}"
    text = (
        f"{samples} at {_number(imu.median_rate_hz, 1)} Hz (median; "
        f"{_number(imu.mean_rate_hz, 1)} really came a second) over "
        f"{report.duration_s:.0f} s; worst gap {_number(imu.worst_gap_s)} s "
        f"({_number(imu.worst_arrival_gap_s)} s between arrivals)"
    )
    yield "IMU", text
    if report.reference is None:
        yield "reference", "none in this log: nothing to compare with"
        return
    is_truth = report.reference == "sim"
    note = "" if is_truth else ": the autopilot's own estimate, which is no truth"
    yield "reference", schema.REFERENCES[report.reference] + note
    yield f"{'error' if is_truth else 'difference'}, RMS", _errors_text(errors)
    yield "", f"inclination 95 %: {_number(errors.inclination_p95)}°"
    upright, pointed, *moving = map(_share, astuple(report.coverage))
    honest = f"inclination {upright}, heading {pointed} (honest: 68 %)"
    yield "under sigma", f"{honest}; in motion {', '.join(moving)}"
    if (turn := report.constant_turn) is not None:
        text = (
            f"{turn.turn_deg:.1f}° of it is a constant turn: mounting or trim; inclination without "
            f"{turn.inclination_rms:.2f}°, {_share(turn.inclination_coverage)} under sigma"
        )
        yield "", text
    norths = report.heading_references
    magnetic = norths.get("magnetic", 0) / max(1, sum(norths.values()))
    if errors.heading_rms is not None and magnetic >= LEAST_SHOWN_SHARE:
        text = (
            f"{_share(magnetic)} of our headings are from magnetic north; where the reference's are"
            " from true north the place's declination stands in the heading's error"
        )
        yield "", text


def _after(report: schema.LogReport) -> Iterator[tuple[str, str]]:
    """What the log shows beside the reference."""
    for name, peer in report.peers.items():
        yield f"{name}'s error", _errors_text(peer)
    for difference in report.differences[:MOST_DIFFERENCES]:
        yield "autopilot differs", difference_text(difference)
    yield "under 5° after", f"{_number(report.convergence_s)} s"
    yield "gain K", f"{report.mean_gain:.2f}, mean"
    counts = ", ".join(f"{count} {reason}" for reason, count in report.rejected.items())
    yield "refused", counts or "nothing"
    yield "took", f"{report.wall_s:.2f} s"


def difference_text(difference: schema.DifferenceSummary) -> str:
    """When the autopilot's attitude differed from ours, by how much, and who is likely wrong."""
    who = {"autopilot": "the autopilot's is likely wrong", "ours": "ours is likely wrong"}
    wrong = who.get(difference.wrong, "nothing shows which is wrong")
    return (
        f"{difference.begin_s:.0f} to {difference.end_s:.0f} s, inclination by up to "
        f"{difference.inclination_deg:.0f}°, heading {difference.heading_deg:.0f}°; {wrong}: "
        f"{difference.evidence}"
    )


def _errors_text(errors: schema.ErrorSummary) -> str:
    total, heading, inclination, _ = map(_number, astuple(errors))
    return f"total {total}°, heading {heading}°, inclination {inclination}°"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.0f} %"


@contextmanager
def reading_bar(log: LogFile) -> Iterator[None]:
    """How far a log has been read, from its second piece on, where that goes to a terminal."""
    console, name = Console(stderr=True), TextColumn("{task.description}", markup=False)
    columns = (name, BarColumn(), DownloadColumn(), TimeRemainingColumn())
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        size = log.path.stat().st_size
        task = bar.add_task(printable(log.path.name), total=size, visible=False)
        if not hidden:
            log.on_read = lambda done: bar.update(task, completed=done, visible=done > 0)
        try:
            yield
        finally:
            log.on_read = None
