"""A figure in a file: PNG, SVG and PDF by matplotlib, and a page that zooms.

Each of its axes shows a legend, tick labels of x and of y only where it is given their names.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from drivers.output_file import written_for
from estimator.errors import InputError
from fuzzbee.options import require_extra
from fuzzbee.replays.page import write_page

# For each suffix the metadata that would make two files of the same figure differ.
METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
PAGE = ".html"
COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple")
DARK, BLACK = "0.35", "0.15"
STYLE: Any = {
    "font.size": 8.0,
    "lines.linewidth": 0.8,
    "axes.grid": True,
    "axes.titlelocation": "left",
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "legend.fontsize": 7.0,
    "legend.borderaxespad": 0.2,
    "path.simplify": True,
    "pdf.fonttype": 42,  # text stays text
    "savefig.dpi": 150,  # enough to print
    "svg.hashsalt": "fuzzbee",  # stands for the random names that SVG elements would get
}
LAYOUT_DIGITS = 5
TITLE_WIDTH = 84  # letters in a line; a file's name may have no blanks


def require_plot(path: Path) -> None:
    """Refuse early what cannot be drawn."""
    suffix = path.suffix.lower()
    if suffix not in (*METADATA, PAGE):
        raise InputError(f"--plot {path}: should end in {', '.join((*METADATA, PAGE))}")
    for library in ("matplotlib", "plotly") if suffix == PAGE else ("matplotlib",):
        require_extra(library, f"--plot {path}", "page" if suffix == PAGE else "plot")


@contextmanager
def written_figure(
    path: Path, title: str, inches: tuple[float, float], *, is_over_log: bool = False
) -> Iterator[Any]:
    """A matplotlib figure to draw on, then written by the suffix, the same bytes each time.

    A page of one that ``is_over_log`` shows which options replay the seconds that are seen.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        sheet = Figure(figsize=inches, layout="constrained")
        sheet.suptitle("\n".join(wrap(title, TITLE_WIDTH)))
        yield sheet
        for ax in sheet.axes:
            if not ax.get_label():  # that of a colour bar has one
                names = bool(ax.get_xlabel()), bool(ax.get_ylabel())
                ax.tick_params(labelbottom=names[0], labelleft=names[1])
        sheet.align_ylabels()
        # the layout is solved anew each time, to other last digits
        sheet.draw_without_rendering()
        sheet.set_layout_engine("none")
        for ax in sheet.axes:
            left, bottom, width, height = np.round(ax.get_position().bounds, LAYOUT_DIGITS).tolist()
            ax.set_position((left, bottom, width, height))
        suffix = path.suffix.lower()
        with written_for("--plot", path) as fresh:
            if suffix == PAGE:
                write_page(sheet, fresh, is_over_log=is_over_log)
            else:
                metadata: Any = METADATA[suffix]
                sheet.savefig(fresh, format=suffix[1:], metadata=metadata)


def add_legend(ax: Any, columns: int) -> None:
    """The names of what has one, so many in a row, above the right end."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns)


def add_text(ax: Any, text: str) -> None:
    """A text in the upper left corner."""
    paper = {"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 1.0}
    look: Any = {"va": "top", "fontsize": "small", "bbox": paper}
    ax.text(0.01, 0.93, text, transform=ax.transAxes, **look)
