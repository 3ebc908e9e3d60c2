"""Replay reports as tables for a person."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from fuzzbee.log_report import LogReport
    from fuzzbee.simulation_report import SimulationReport


def print_reports(reports: "Sequence[LogReport]") -> None:
    """One row a log, then what was refused."""
    table = Table(title=None, header_style="bold", expand=False)
    table.add_column("log", overflow="fold")
    for heading in ("vehicle", "IMU", "Hz", "gap s", "length s", "reference"):
        table.add_column(heading, justify="left" if heading in ("vehicle", "IMU") else "right")
    for heading in ("total°", "heading°", "incl.°", "p95°", "converged s", "gain"):
        table.add_column(heading, justify="right")
    for report in reports:
        table.add_row(*_row(report))
    console = Console()
    console.print(table)
    for report in reports:
        for name, peer in report.peers.items():
            console.print(
                f"{_name(report)}: the {name}'s own error: "
                f"total {_number(peer.total_rms)}°, "
                f"heading {_number(peer.heading_rms)}°, inclination {_number(peer.inclination_rms)}°"
            )
        if report.rejected:
            counts = ", ".join(f"{count} {reason}" for reason, count in report.rejected.items())
            console.print(f"{_name(report)}: refused {counts}")


def print_simulation(report: "SimulationReport") -> None:
    """The paper's figures."""
    table = Table(header_style="bold")
    for heading in ("seeds", "cost J", "steady e", "settled s", "mean gain", "total°", "run s"):
        table.add_column(heading, justify="right")
    table.add_row(
        f"{report.seeds[0]}-{report.seeds[1]}",
        f"{report.cost:.3f}",
        f"{report.steady_state_error:.5f}",
        _number(report.settling_s),
        f"{report.mean_gain:.2f}",
        _number(report.error_deg.total_rms),
        f"{report.wall_s:.2f}",
    )
    Console().print(table)


def _row(report: "LogReport") -> list[str]:
    vehicle = report.vehicle
    kind = vehicle.type.lower() if vehicle.type else "?"
    return [
        _name(report),
        f"{vehicle.system_id} {kind}",
        report.imu.message,
        _number(report.imu.median_rate_hz, 1),
        _number(report.imu.worst_gap_s),
        f"{report.duration_s:.0f}",
        report.reference or "none",
        _number(report.error_deg.total_rms),
        _number(report.error_deg.heading_rms),
        _number(report.error_deg.inclination_rms),
        _number(report.error_deg.inclination_p95),
        _number(report.convergence_s),
        f"{report.mean_gain:.2f}",
    ]


def _name(report: "LogReport") -> str:
    return report.source.rpartition("/")[2]


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
