"""A figure as a page for a browser: one file that needs no network, its panels zoom together."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

# What matplotlib has drawn, and plotly draws again.
Drawn = tuple[Any, dict[str, Any]]

# A page as wide as a screen, and high enough for each panel to be read (pixels an inch).
PIXELS_AN_INCH = 110
DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
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


def write_page(figure: Any, path: Path, *, is_over_log: bool = False) -> None:
    """Write a matplotlib figure, whose layout is settled, as an interactive page.

    Lines, shaded areas, bands and their names are the figure's own, so are ranges and places of
    the panels; those over time move together. The same figure gives the same bytes. Above one that
    ``is_over_log`` stand the options that replay the seconds that are seen.

    Raises:
        OSError: the file cannot be written.
    """
    from plotly.graph_objects import Figure

    page = Figure()
    page.update_layout(
        title={"text": _lines(figure.get_suptitle()), "font": {"size": 14}},
        height=PIXELS_AN_INCH * figure.get_figheight(),
        margin={"l": 0, "r": 0, "t": 40, "b": 0},  # the panels leave room for their names
        template="plotly_white",
        hovermode="x",
    )
    for number, ax in enumerate(figure.axes, 1):
        _add_panel(page, str(number), ax, figure.axes)
    after = WINDOW_OPTIONS if is_over_log else None
    page.write_html(
        path, include_plotlyjs=True, div_id="fuzzbee", config=BUTTONS, post_script=after
    )


def _add_panel(page: Any, number: str, ax: Any, others: list[Any]) -> None:
    """One panel where the figure has it, with a legend above its right end."""
    place, together = ax.get_position(), ax.get_shared_x_axes()
    first = 1 + next(
        k for k, other in enumerate(others) if other is ax or together.joined(ax, other)
    )
    page.update_layout(
        {
            f"xaxis{number}": {
                "domain": [place.x0, place.x1],
                "anchor": f"y{number}",
                "range": _range(ax.get_xscale(), ax.get_xlim()),
                "type": ax.get_xscale(),
                "title": {"text": _lines(ax.get_xlabel())},
                "showticklabels": any(label.get_visible() for label in ax.get_xticklabels()),
                "matches": f"x{first}" if str(first) != number else None,
            },
            f"yaxis{number}": {
                "domain": [place.y0, place.y1],
                "anchor": f"x{number}",
                "range": _range(ax.get_yscale(), ax.get_ylim()),
                "type": ax.get_yscale(),
                "title": {"text": _lines(ax.get_ylabel())},
            },
            f"legend{number}": {
                "orientation": "h",
                "x": place.x1,
                "xanchor": "right",
                "y": place.y1,
                "yanchor": "bottom",
            },
        }
    )
    if ax.get_title(loc="left"):
        title = {"text": ax.get_title(loc="left"), "showarrow": False, "xanchor": "left"}
        corner = {"x": place.x0, "y": place.y1, "yanchor": "bottom"}
        page.add_annotation(**title, **corner, xref="paper", yref="paper")
    for text in ax.texts:  # in a corner of the panel, or beside a moment
        x, y = text.get_position()
        here = "" if number == "1" else number
        at_time, _ = text.get_transform().contains_branch_seperately(ax.transData)
        across = f"x{here}" if at_time else f"x{here} domain"
        corner = {"x": x, "xref": across, "y": y, "yref": f"y{here} domain"}
        said = {"text": _lines(text.get_text()), "showarrow": False, "xanchor": text.get_ha()}
        said["textangle"] = -text.get_rotation()
        look = {"bgcolor": "rgba(255,255,255,0.7)", "yanchor": text.get_va()}
        page.add_annotation(**said, **corner, **look)
    axes = {"xaxis": f"x{number}", "yaxis": f"y{number}", "legend": f"legend{number}"}
    for artist, trace in (*_bands(ax), *_areas(ax), *_curves(ax)):
        name = artist.get_label()
        # matplotlib's own names, which begin with _, are none
        named = bool(ax.get_legend()) and not name.startswith("_")
        page.add_scatter(**trace, **axes, name=name, showlegend=named)


def _curves(ax: Any) -> Iterator[Drawn]:
    """The lines."""
    for line in ax.lines:
        x, y = (np.asarray(part, dtype=float) for part in line.get_data())
        over_time, has_values = line.get_transform().contains_branch_seperately(ax.transData)
        if not has_values:  # a moment, from the bottom to the top
            y = np.array(ax.get_ylim())
        if not over_time:  # a level, from one side to the other
            x = np.array(ax.get_xlim())
        dash = DASHES.get(line.get_linestyle(), "dash")
        look = {"color": _colour(line.get_color(), line.get_alpha()), "dash": dash}
        look["width"] = 1.5 * line.get_linewidth()
        yield line, {"x": x, "y": y, "mode": "lines", "line": look}


def _areas(ax: Any) -> Iterator[Drawn]:
    """What is filled between two lines."""
    for area in ax.collections:
        colour = _colour(area.get_facecolor()[0], None)
        outlines = [outline.vertices for outline in area.get_paths()]
        x, y = np.concatenate([[*each, (np.nan, np.nan)] for each in outlines])[:-1].T
        yield area, {"x": x, "y": y, **_filled(colour)}


def _bands(ax: Any) -> Iterator[Drawn]:
    """Intervals of time: over the whole height that is shown."""
    low, high = ax.get_ylim()
    for band in ax.patches:
        x0, x1 = band.get_x(), band.get_x() + band.get_width()
        x, y = [x0, x0, x1, x1, x0], [low, high, high, low, low]
        yield band, {"x": x, "y": y, **_filled(_colour(band.get_facecolor(), None))}


def _filled(colour: str) -> dict[str, Any]:
    look = {"fill": "toself", "fillcolor": colour, "hoverinfo": "skip"}
    return {"mode": "lines", "line": {"width": 0}, **look}


def _colour(colour: Any, alpha: float | None) -> str:
    from matplotlib.colors import to_rgba

    red, green, blue, opaque = to_rgba(colour, alpha)
    return f"rgba({255 * red:.0f},{255 * green:.0f},{255 * blue:.0f},{opaque:.2f})"


def _range(scale: str, limits: tuple[float, float]) -> list[float]:
    """As plotly has it: of a logarithmic axis the exponents."""
    return [float(each) for each in (np.log10(limits) if scale == "log" else limits)]


def _lines(text: str) -> str:
    """A text in HTML; of mathematics the figures have no more than a tilde."""
    return text.replace("\n", "<br>").replace("$", "").replace(r"\tilde R", "R\N{COMBINING TILDE}")
