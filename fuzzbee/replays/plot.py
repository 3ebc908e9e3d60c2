"""A replay as a figure: attitude, errors and sigma, gain, confidences, bias and gaps."""

from math import isnan
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np

from drivers.output_file import written_for
from estimator.arrays import Floats
from estimator.errors import InputError
from fuzzbee.angle_curves import draw_angles
from fuzzbee.options import require_extra
from fuzzbee.replays.bands import bands
from fuzzbee.replays.comparison import REFERENCES, Comparison, reference_attitudes
from fuzzbee.replays.marks import seconds_of
from fuzzbee.replays.page import write_page
from fuzzbee.replays.score import errors_against
from fuzzbee.replays.thinned import Thinned
from fuzzbee.replays.trace import VehicleTrace

# For each suffix the metadata that would make two files of the same figure differ.
METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
PAGE = ".html"
# A page between its margins, and dots enough to print.
FIGURE_INCHES = (7.1, 9.8)
DOTS_PER_INCH = 150
STYLE: Any = {
    "font.size": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 7.0,
    "legend.borderaxespad": 0.2,
    "path.simplify": True,
    "pdf.fonttype": 42,  # text stays text
    "svg.hashsalt": "fuzzbee",  # stands for the random names that SVG elements would get
}
LAYOUT_DIGITS = 5
# The letters that a line of the title takes at most
TITLE_WIDTH = 84
# Told apart in print without colours, too: thick, dashed, thin.
REFERENCE: dict[str, Any] = {"color": "0.15", "lw": 1.6}
AUTOPILOT: dict[str, Any] = {"color": "C2", "lw": 0.9, "ls": (0, (4, 2))}
MARK: dict[str, Any] = {"rotation": 90.0, "fontsize": 5.5, "va": "top", "ha": "left"}
ESTIMATE: dict[str, Any] = {"color": "C1", "lw": 0.8}


class Drawn(NamedTuple):
    """What is drawn, with what the autopilot has beside a truth.

    ``autopilot`` are its attitudes (N, 4) and errors (N, 3), NaN where it has none.
    """

    time_s: Floats
    trace: VehicleTrace
    compared: Comparison
    autopilot: tuple[Floats, Floats] | None
    points: Thinned

    def plot(self, ax: Any, values: Floats, *style: str, **line: Any) -> None:
        """A line of values (N,) over time."""
        ax.plot(self.points.time_s, self.points.every(values), *style, **line)

    def plot_largest(self, ax: Any, values: Floats, *style: str, **line: Any) -> None:
        """The same, of values whose peaks tell."""
        ax.plot(self.points.time_s, self.points.largest(values), *style, **line)


# The autopilot is no truth: from it an estimate only differs.
ERROR_WORDS = {"sim": "error", "autopilot": "difference"}


def require_plot(path: Path) -> None:
    """Refuse early what cannot be drawn.

    Raises:
        InputError: an unknown suffix, or a missing library.
    """
    suffix = path.suffix.lower()
    if suffix not in (*METADATA, PAGE):
        raise InputError(f"--plot {path}: should end in {', '.join((*METADATA, PAGE))}")
    require_extra("matplotlib", f"--plot {path}", "plot")
    if suffix == PAGE:
        require_extra("plotly", f"--plot {path}", "page")


def draw(path: Path, title: str, trace: VehicleTrace, compared: Comparison) -> None:
    """Draw the trace into a file whose suffix says how.

    Raises:
        InputError: the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    time_s = trace.time_s
    drawn = Drawn(time_s, trace, compared, _autopilot(trace, compared), Thinned(time_s))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
        axes = figure.subplots(8, 1, sharex=True)
        figure.suptitle(title_lines(title))
        _attitude(axes[:3], drawn)
        _errors(axes[3:5], drawn)
        _internals(axes[5:], drawn)
        _bands(axes, drawn)
        _marks(axes, drawn)
        for ax in axes:
            ax.grid(visible=True, alpha=0.3)
        if axes[5].get_legend_handles_labels()[0]:
            legend_above(axes[5], 6)
        figure.align_ylabels(axes)
        axes[-1].set_xlabel("time in s")
        axes[-1].set_xlim(time_s[0], max(time_s[-1], time_s[0] + 1e-3))
        save(figure, path, is_over_log=True)


def save(figure: Any, path: Path, *, is_over_log: bool = False) -> None:
    """Write the figure as the file's suffix says, the same bytes each time.

    The page of one that ``is_over_log`` shows which options replay the seconds that are seen.

    Raises:
        InputError: the file cannot be written.
    """
    _settle(figure)
    suffix = path.suffix.lower()
    with written_for("--plot", path) as fresh:
        if suffix == PAGE:
            write_page(figure, fresh, is_over_log=is_over_log)
        else:
            look = {"dpi": DOTS_PER_INCH, "metadata": METADATA[suffix]}
            figure.savefig(fresh, format=suffix[1:], **look)


def _settle(figure: Any) -> None:
    """Round where the axes stand: their layout is solved anew each time, to other last digits."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for ax in figure.axes:
        ax.set_position([round(part, LAYOUT_DIGITS) for part in ax.get_position().bounds])


def title_lines(title: str) -> str:
    """The title in lines that the page is wide enough for; a file's name may have no blanks."""
    return "\n".join(wrap(title, TITLE_WIDTH))


def legend_above(ax: Any, ncols: int) -> None:
    """A legend beside the data, not on them."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=ncols)


def _autopilot(trace: VehicleTrace, compared: Comparison) -> tuple[Floats, Floats] | None:
    """The autopilot's own estimate, where there is a truth to hold both against."""
    if compared.source != "sim" or trace.references["autopilot"].message is None:
        return None
    attitudes, known = reference_attitudes(trace, "autopilot")
    errors = errors_against(attitudes, compared.truth)
    both = (known & compared.known)[:, None]
    return np.where(known[:, None], attitudes, np.nan), np.where(both, errors, np.nan)


def _attitude(axes: Any, drawn: Drawn) -> None:
    """Roll, pitch and heading."""
    compared, points = drawn.compared, drawn.points
    truth = np.where(compared.known[:, None], compared.truth, np.nan)
    curves = [(drawn.trace.estimates, ESTIMATE, "estimate")]
    if drawn.autopilot is not None:
        curves.insert(0, (drawn.autopilot[0], AUTOPILOT, "autopilot"))
    if compared.source is not None:
        curves.insert(0, (truth, REFERENCE, REFERENCES[compared.source]))
    draw_angles(axes, points.time_s, [(points.every(q), line, label) for q, line, label in curves])
    legend_above(axes[0], len(curves))


def _errors(axes: Any, drawn: Drawn) -> None:
    """Inclination and heading error with the published sigma, and the autopilot's error."""
    compared, points = drawn.compared, drawn.points
    sigmas = (
        drawn.trace.column("sigma_inclination_rad"),
        drawn.trace.column("sigma_heading_rad"),
    )
    what = ERROR_WORDS.get(compared.source or "", "sigma")
    errors = np.degrees(np.where(compared.known[:, None], compared.errors_rad, np.nan))
    for ax, name, i, sigma in zip(axes, ("inclination", "heading"), (2, 1), sigmas, strict=True):
        within = points.every(np.degrees(sigma))
        ax.fill_between(points.time_s, within, color="C0", alpha=0.25, lw=0, label="sigma")
        if drawn.autopilot is not None:
            theirs = np.degrees(drawn.autopilot[1][:, i])
            drawn.plot_largest(ax, theirs, **AUTOPILOT, label="autopilot's error")
        if compared.source is not None:
            drawn.plot_largest(ax, errors[:, i], "C3-", lw=0.8, label=what)
        ax.set_ylabel(f"{name}\n{what} in °")
        cap(ax, errors[:, i], np.degrees(sigma))
    legend_above(axes[0], 3)


def _internals(axes: Any, drawn: Drawn) -> None:
    """Gain, confidences and bias."""
    column = drawn.trace.column
    drawn.plot_largest(axes[0], column("gain"), "C2-", lw=0.8)
    axes[0].set_ylabel("gain K")
    axes[0].set_ylim(bottom=0.0)
    drawn.plot(axes[1], column("confidence_gravity"), "C0-", lw=0.8, label="gravity")
    drawn.plot(axes[1], column("confidence_magnetic"), "C4-", lw=0.8, label="magnetic")
    axes[1].set_ylabel("confidence")
    axes[1].set_ylim(0.0, None)
    legend_above(axes[1], 2)
    bias = np.degrees(drawn.trace.column("gyro_bias_rad_s"))
    for i, name in enumerate("xyz"):
        drawn.plot(axes[2], bias[:, i], lw=0.8, label=name)
    axes[2].set_ylabel("gyro bias\nin °/s")
    legend_above(axes[2], 3)


def _bands(axes: Any, drawn: Drawn) -> None:
    """Shade what was wrong and what helped, in all panels, and name it above the gain."""
    for label, look, spans in bands(drawn.time_s, drawn.trace, drawn.compared):
        for ax in axes:
            for number, span in enumerate(spans):
                name = label if ax is axes[5] and number == 0 else "_band"
                ax.axvspan(*span, lw=0, **look, label=name)


def _marks(axes: Any, drawn: Drawn) -> None:
    """Name in the first panel when mode or arming changed, or the autopilot warned."""
    trace = drawn.trace
    arrivals_us = trace.arrivals_us.rows()
    marks = trace.marks.found(int(arrivals_us[0]), trace.autopilot, trace.vehicle_type)
    seconds = seconds_of(marks, arrivals_us, drawn.time_s).tolist()
    for mark, at_s in zip(marks, seconds, strict=True):
        if isnan(at_s):  # after the last sample
            continue
        for ax in axes:
            ax.axvline(at_s, color="0.35", lw=0.5, ls=":", label="_mark")
        axes[0].text(at_s, 0.97, mark.text, **MARK, transform=axes[0].get_xaxis_transform())


def cap(ax: Any, *angles_deg: Floats) -> None:
    """Give the panel a height that shows nearly all of those, and write there what is cut off."""
    finite = np.concatenate([each[np.isfinite(each)] for each in angles_deg])
    ceiling = max(1.0, 1.3 * float(np.percentile(finite, 99.0))) if len(finite) else 1.0
    ax.set_ylim(0.0, ceiling)
    peak = max((np.nanmax(line.get_ydata(), initial=0.0) for line in ax.lines), default=0.0)
    if peak > ceiling:
        note(ax, f"cut off: errors up to {peak:.0f}°")


def note(ax: Any, said: str) -> None:
    """Words in the panel's upper corner, readable over a line."""
    paper = {"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 1.0}
    ax.text(0.01, 0.93, said, transform=ax.transAxes, va="top", fontsize="small", bbox=paper)
