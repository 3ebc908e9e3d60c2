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
from estimator.filter.memberships import TERMS, Five
from fuzzbee.options import require_extra

# For each suffix the metadata that would make two files of the same figure differ.
METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
PAGE = ".html"
COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple")
DARK, BLACK = "0.35", "0.15"
TRIANGLE = (0.0, 1.0, 0.0)  # the membership at a fuzzy set's corners
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
PIXELS_AN_INCH = 130  # of a page as wide as a screen: high enough for all axes to be read
MARGIN = {"l": 0, "r": 0, "t": 30, "b": 0}  # for the buttons
WIDER = 1.5  # than on paper a line has to be
PAPER = "rgba(255,255,255,0.7)"  # under words, so that they are readable over a line
DASHES = {"-": "solid", "--": "dash", ":": "dot"}
BUTTONS = {"displaylogo": False, "responsive": True}
# Follows the zoomed axis of time.
WINDOW_OPTIONS = """
const page = document.getElementById('{plot_id}'), line = document.createElement('pre');
page.before(line);
const show = () => {
  const [from, to] = page.layout.xaxis.range.map(s => Math.max(0, s).toFixed(1));
  line.textContent = `These seconds alone: fuzzbee replay LOG --from ${from} --to ${to}`;
};
page.on('plotly_relayout', show);
show();
"""


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
        axes = [ax for ax in sheet.axes if not ax.get_label()]  # that of a colour bar has one
        for ax in axes:
            ax.tick_params(labelbottom=bool(ax.get_xlabel()), labelleft=bool(ax.get_ylabel()))
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
                _write_page(sheet, axes, fresh, WINDOW_OPTIONS if is_over_log else None)
            else:
                metadata: Any = METADATA[suffix]
                sheet.savefig(fresh, format=suffix[1:], metadata=metadata)


def add_legend(ax: Any, columns: int) -> None:
    """The names of what has one, so many in a row, above the right end."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns)


def draw_sets(ax: Any, label: str, sets: Five, before: Five | None = None) -> None:
    """The membership of five fuzzy sets, and dotted those that were there before."""
    for term, corners, color in zip(TERMS, sets, COLORS, strict=True):
        ax.plot(corners, TRIANGLE, color=color, label=term, lw=1.2)
    for corners, color in zip(before or (), COLORS, strict=False):
        ax.plot(corners, TRIANGLE, ":", color=color)
    ax.set(xlabel=label, ylabel="membership")
    add_legend(ax, len(TERMS))


def add_text(ax: Any, text: str) -> None:
    """A text in the upper left corner."""
    paper = {"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 1.0}
    look: Any = {"va": "top", "fontsize": "small", "bbox": paper}
    ax.text(0.01, 0.93, text, transform=ax.transAxes, **look)


# --- the page, whose axes zoom together; one file that needs no network


def _write_page(sheet: Any, axes: list[Any], path: Path, script: str | None) -> None:
    """Write a matplotlib figure as a page; axes with the same range of x zoom together."""
    from plotly.io import write_html

    title = {"text": _html(sheet.get_suptitle()), "font": {"size": 14}, "x": 0.5, "y": 0.99}
    layout: dict[str, Any] = {"title": title, "template": "plotly_white", "hovermode": "x"}
    layout |= {"height": PIXELS_AN_INCH * sheet.get_figheight(), "margin": MARGIN}
    layout |= {"shapes": [], "annotations": []}
    data: list[dict[str, Any]] = []
    firsts: dict[tuple[float, float], str] = {}
    for number, ax in enumerate(axes, 1):
        here = "" if number == 1 else str(number)  # as plotly numbers axes
        first, (x, y) = firsts.setdefault(ax.get_xlim(), here), (f"x{here}", f"y{here}")
        layout |= _axes(here, ax, f"x{first}" if first != here else None)
        data += [{"xaxis": x, "yaxis": y, **trace} for trace in _traces(here, ax)]
        place = {"xref": x, "yref": f"{y} domain"}
        layout["shapes"] += [place | shape for shape in _shapes(here, ax)]
        layout["annotations"] += [place | text for text in _texts(ax)]
    options: Any = {"include_plotlyjs": True, "div_id": "fuzzbee", "config": BUTTONS}
    write_html({"data": data, "layout": layout}, path, post_script=script, **options)


def _axes(here: str, ax: Any, matches: str | None) -> dict[str, Any]:
    """Place, ranges, names, and a legend above the right end."""
    (left, bottom), (right, top) = ax.get_position().get_points().tolist()
    low_high = np.log10(ax.get_ylim()) if ax.get_yscale() == "log" else ax.get_ylim()
    x = {"anchor": f"y{here}", "domain": (left, right), "range": ax.get_xlim(), "matches": matches}
    y = {"anchor": f"x{here}", "domain": (bottom, top), "range": low_high, "type": ax.get_yscale()}
    for axis, label in ((x, ax.get_xlabel()), (y, ax.get_ylabel())):
        axis |= {"title": {"text": _html(label)}, "showticklabels": bool(label)}
        axis["visible"] = ax.axison
    corner = {"x": right, "xanchor": "right", "y": top, "yanchor": "bottom"}
    legend = {"orientation": "h", **corner}
    return {f"xaxis{here}": x, f"yaxis{here}": y, f"legend{here}": legend}


def _traces(here: str, ax: Any) -> Iterator[dict[str, Any]]:
    """Areas, curves and a heat map."""
    from matplotlib.colors import to_hex

    for area in ax.collections:
        if area.colorbar is not None:  # values on a grid
            edges, box = area.get_coordinates(), area.colorbar.ax.get_position()
            bar = {"x": box.x0, "y": box.y0, "yanchor": "bottom", "len": box.height}
            values = {"x": edges[0, :, 0], "y": edges[:, 0, 1], "z": area.get_array()}
            yield {"type": "heatmap", "colorbar": bar, **values}
            continue
        gap = [[np.nan, np.nan]]
        outlines = [part for each in area.get_paths() for part in (each.vertices, gap)]
        x, y = np.concatenate([np.empty((0, 2)), *outlines]).T
        look: Any = {"fill": "toself", "fillcolor": to_hex(area.get_facecolor()[0])}
        look |= {"opacity": area.get_alpha(), "line": {"width": 0}, "hoverinfo": "skip"}
        yield {"x": x, "y": y, "mode": "lines", **look, **_named(here, ax, area)}
    for curve in ax.lines:
        if curve.get_transform() == ax.transData:
            line = {"color": to_hex(curve.get_color()), "dash": DASHES[curve.get_linestyle()]}
            line["width"] = WIDER * curve.get_linewidth()
            values = {"x": curve.get_xdata(), "y": curve.get_ydata()}
            yield {"mode": "lines", "line": line, **values, **_named(here, ax, curve)}


def _shapes(here: str, ax: Any) -> Iterator[dict[str, Any]]:
    """Bands and moments, which go over the whole height."""
    from matplotlib.colors import to_hex

    for band in ax.patches:
        x = band.get_patch_transform().transform(band.get_path().vertices)[:, 0]
        look = {"fillcolor": to_hex(band.get_facecolor()), "opacity": band.get_alpha()}
        look |= {"layer": "below", "line": {"width": 0}, **_named(here, ax, band)}
        yield {"type": "rect", "x0": x.min(), "x1": x.max(), "y0": 0, "y1": 1, **look}
    for mark in ax.lines:
        if mark.get_transform() != ax.transData:
            line = {"color": to_hex(mark.get_color()), "width": 1, "dash": "dot"}
            at = float(mark.get_xdata()[0])
            yield {"type": "line", "x0": at, "x1": at, "y0": 0, "y1": 1, "line": line}


def _named(here: str, ax: Any, artist: Any) -> dict[str, Any]:
    """An artist's name, in the legend if there is one."""
    name = artist.get_label().removeprefix("_")
    is_shown = ax.get_legend() is not None and name == artist.get_label()
    return {"name": name, "showlegend": is_shown, "legend": f"legend{here}"}


def _texts(ax: Any) -> Iterator[dict[str, Any]]:
    """The title, what is written in the axes, and the names of moments."""
    corner, size = ax.get_position().get_points()[0], ax.get_position().size
    paper = {"xref": "paper", "yref": "paper"}  # axes without a curve are no place for plotly
    if title := ax.get_title("left"):
        x, y = corner + size * (0.0, 1.0)
        look = {"xanchor": "left", "yanchor": "bottom", "showarrow": False}
        yield {"text": _html(title), "x": x, "y": y, **look, **paper}
    for text in ax.texts:
        place, side = text.get_position(), text.get_verticalalignment()
        look = {"textangle": -text.get_rotation(), "bgcolor": PAPER, "showarrow": False}
        look |= {"xanchor": text.get_horizontalalignment()}
        look["yanchor"] = "middle" if side == "center" else side
        if text.get_transform() == ax.transAxes:
            place, look = corner + size * place, look | paper
        yield {"text": _html(text.get_text()), "x": place[0], "y": place[1], **look}


def _html(text: str) -> str:
    """A text in HTML; of mathematics the figures have no more than a tilde."""
    return text.replace("\n", "<br>").replace("$", "").replace(r"\tilde R", "R\N{COMBINING TILDE}")
