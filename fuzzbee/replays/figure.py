"""A figure in a file: PNG, SVG and PDF by matplotlib, and a page that zooms."""

from math import inf
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from drivers.output_file import written_for
from estimator.errors import InputError
from fuzzbee.options import require_extra
from fuzzbee.replays.page import write_page
from fuzzbee.replays.panels import DARK, Figure, Panel

# For each suffix the metadata that would make two files of the same figure differ.
METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
PAGE = ".html"
DOTS_PER_INCH = 150  # enough to print
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
NEAR = 0.015  # of the width: names of two marks would hide each other
TITLE_WIDTH = 84  # letters in a line; a file's name may have no blanks


def require_plot(path: Path) -> None:
    """Refuse early what cannot be drawn."""
    suffix = path.suffix.lower()
    if suffix not in (*METADATA, PAGE):
        raise InputError(f"--plot {path}: should end in {', '.join((*METADATA, PAGE))}")
    library, extra = ("plotly", "page") if suffix == PAGE else ("matplotlib", "plot")
    require_extra(library, f"--plot {path}", extra)


def save(figure: Figure, path: Path) -> None:
    """Write the figure as the file's suffix says, the same bytes each time."""
    figure.title = "\n".join(wrap(figure.title, TITLE_WIDTH))
    suffix = path.suffix.lower()
    with written_for("--plot", path) as fresh:
        if suffix == PAGE:
            write_page(figure, fresh)
        else:
            _draw(figure, fresh, suffix)


def _draw(figure: Figure, path: Path, suffix: str) -> None:
    import matplotlib as mpl
    from matplotlib import figure as plain

    with mpl.rc_context(STYLE):
        sheet = plain.Figure(figsize=figure.inches, layout="constrained")
        sheet.suptitle(figure.title)
        ratios: Any = {"height_ratios": figure.heights, "width_ratios": figure.widths}
        grid = sheet.add_gridspec(len(figure.rows), figure.columns, **ratios)
        for row, panels in enumerate(figure.rows):
            for column, panel in enumerate(panels):
                place = grid[row, :] if len(panels) == 1 else grid[row, column]
                _draw_panel(sheet.add_subplot(place), panel)
        sheet.align_ylabels()
        # the layout is solved anew each time, to other last digits
        sheet.draw_without_rendering()
        sheet.set_layout_engine("none")
        for ax in sheet.axes:
            left, bottom, width, height = np.round(ax.get_position().bounds, LAYOUT_DIGITS).tolist()
            ax.set_position((left, bottom, width, height))
        look: Any = {"dpi": DOTS_PER_INCH, "metadata": METADATA[suffix]}
        sheet.savefig(path, format=suffix[1:], **look)


def _draw_panel(ax: Any, panel: Panel) -> None:
    for x, low, high, color, alpha, label in panel.areas:
        ax.fill_between(x, low, high, color=color, alpha=alpha, lw=0, label=label)
    for label, color, alpha, spans in panel.bands:
        for number, span in enumerate(spans):
            name = label if label and number == 0 else "_band"
            ax.axvspan(*span, color=color, alpha=alpha, lw=0, label=name)
    for x, y, color, label, width, dash in panel.curves:
        ax.plot(x, y, dash, color=color, lw=width, label=label or "_curve")
    least = 0.0 if panel.span is None else NEAR * (panel.span[1] - panel.span[0])
    last, is_right = -inf, False
    for at, label in panel.marks:
        ax.axvline(at, color=DARK, lw=0.5, ls=":", label="_mark")
        if label:
            # of two that are near each other one name stands on either side
            is_right, last = at - last < least and not is_right, at
            turned: Any = {"rotation": 90.0, "fontsize": 5.5, "va": "top"}
            turned["ha"] = "right" if is_right else "left"
            ax.text(at, 0.97, label, **turned, transform=ax.get_xaxis_transform())
    for text, across, up, is_centred in panel.words:
        side = ("center", "center") if is_centred else ("left", "top")
        paper = {"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 1.0}
        look: Any = {"fontsize": "small", "bbox": paper, "transform": ax.transAxes}
        ax.text(across, up, text, ha=side[0], va=side[1], **look)
    if panel.heat is not None:
        x, y, values = panel.heat
        ax.figure.colorbar(ax.pcolormesh(x, y, values, rasterized=True), ax=ax)
    ax.set_title(panel.title, loc="left")
    if panel.span is None:
        ax.axis("off")
        return
    ax.set(xlabel=panel.xlabel, ylabel=panel.ylabel, xlim=panel.span)
    ax.tick_params(labelbottom=bool(panel.xlabel), labelleft=bool(panel.ylabel))
    ax.set_yscale("log" if panel.is_log else "linear")
    ax.set_ylim(panel.low, panel.high)
    if panel.heat is None:
        ax.grid(visible=True, alpha=0.3)
    if panel.names and ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=panel.names)
