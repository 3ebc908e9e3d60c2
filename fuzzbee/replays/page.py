"""A figure as a page for a browser: one file that needs no network, its panels zoom together."""

from math import log10
from pathlib import Path
from typing import Any

import numpy as np

from estimator.arrays import Floats
from fuzzbee.replays.panels import DARK, Area, Figure, Panel, Words

# A page as wide as a screen, and high enough for each panel to be read (pixels an inch).
PIXELS_AN_INCH = 110
BETWEEN, BESIDE_NAMES = 32, 75  # pixels from panel to panel; where axes have names
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


def write_page(figure: Figure, path: Path) -> None:
    """Write a figure as an interactive page; the same figure gives the same bytes."""
    from plotly.subplots import make_subplots

    height, count = PIXELS_AN_INCH * figure.inches[1], figure.columns
    between = BETWEEN
    if any(panel.xlabel for row in figure.rows[:-1] for panel in row):
        between = BESIDE_NAMES
        height += between * (len(figure.rows) - 1)
    alone = [{"colspan": count}, *[None] * (count - 1)]
    page = make_subplots(
        len(figure.rows),
        count,
        specs=[[{}] * count if len(row) == count else alone for row in figure.rows],
        row_heights=figure.heights,
        column_widths=figure.widths,
        vertical_spacing=between / height,
        horizontal_spacing=0.08,
    )
    page.update_layout(
        title={"text": _lines(figure.title), "font": {"size": 14}},
        height=height,
        margin={"l": 70, "r": 20, "t": 80, "b": 50},
        template="plotly_white",
        hovermode="x",
    )
    firsts: dict[Any, int] = {}  # the panel that those of the same span zoom with
    places = [(r, c, p) for r, row in enumerate(figure.rows, 1) for c, p in enumerate(row, 1)]
    for number, (row, column, panel) in enumerate(places, 1):
        first = firsts.setdefault(panel.span, number)
        _set_axes(page, number, panel, None if first == number else f"x{first}")
        _add_traces(page, panel, {"row": row, "col": column}, f"legend{number}")
        _add_words(page, number, panel)
    after = WINDOW_OPTIONS if figure.is_over_log else None
    page.write_html(
        path, include_plotlyjs=True, div_id="fuzzbee", config=BUTTONS, post_script=after
    )


def _set_axes(page: Any, number: int, panel: Panel, matches: str | None) -> None:
    """Ranges, names, and a legend above the panel's right end."""
    x, y = page.layout[f"xaxis{number}"], page.layout[f"yaxis{number}"]
    if panel.span is None:
        x.visible = y.visible = False
        return
    x.update(title=panel.xlabel, range=panel.span, showticklabels=bool(panel.xlabel))
    x.matches = matches
    y.update(title=_lines(panel.ylabel), showticklabels=bool(panel.ylabel))
    y.type, y.rangemode = "log" if panel.is_log else "linear", "tozero" if panel.low == 0 else None
    if panel.low is not None and panel.high is not None:
        limits = (panel.low, panel.high)
        y.range = [log10(each) for each in limits] if panel.is_log else limits
    corner = {"x": x.domain[1], "xanchor": "right", "y": y.domain[1], "yanchor": "bottom"}
    page.update_layout({f"legend{number}": {"orientation": "h", **corner}})


def _add_traces(page: Any, panel: Panel, place: dict[str, int], legend: str) -> None:
    def named(label: str, number: int = 0) -> dict[str, Any]:
        is_shown = bool(panel.names and label and number == 0)
        return {"name": label, "showlegend": is_shown, "legend": legend, **place}

    for area in panel.areas:
        x, y = _outline(area)
        look = {"fill": "toself", "fillcolor": area.color, "opacity": area.alpha}
        look |= {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
        page.add_scatter(x=x, y=y, **look, **named(area.label))
    for curve in panel.curves:
        look = {"color": curve.color, "dash": DASHES[curve.dash], "width": 1.5 * curve.width}
        page.add_scatter(x=curve.x, y=curve.y, mode="lines", line=look, **named(curve.label))
    for band in panel.bands:
        look = {"fillcolor": band.color, "opacity": band.alpha, "line_width": 0, "layer": "below"}
        for number, (begin, end) in enumerate(band.spans):
            page.add_vrect(begin, end, **look, **named(band.label, number))
    for mark in panel.marks:
        page.add_vline(mark.x, line={"color": DARK, "width": 1, "dash": "dot"}, **place)
    if panel.heat is not None:
        x, y, values = panel.heat
        page.add_heatmap(x=x, y=y, z=values, colorbar={"len": 0.4, "y": 0.2}, **place)


def _outline(area: Area) -> tuple[Floats, Floats]:
    """A closed line around each part of the area between two gaps."""
    known = np.flatnonzero(np.isfinite(area.low + area.high))
    gap = np.array([np.nan])
    x, y = list[Floats](), list[Floats]()
    for part in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        x += [area.x[part], area.x[part][::-1], gap]
        y += [area.low[part], area.high[part][::-1], gap]
    return np.concatenate(x), np.concatenate(y)


def _add_words(page: Any, number: int, panel: Panel) -> None:
    """The title, what is written in the panel, and the names of moments."""
    x, y = (page.layout[f"{axis}{number}"].domain for axis in ("xaxis", "yaxis"))
    title = [Words(panel.title, 0.0, 1.0)] if panel.title else []
    for text, at, up, is_centred in (*title, *panel.words):
        place: Any = {"xref": "paper", "x": x[0] + at * (x[1] - x[0])}
        place |= {"yref": "paper", "y": y[0] + up * (y[1] - y[0])}
        place["xanchor"] = "center" if is_centred else "left"
        place["yanchor"] = "middle" if is_centred else "bottom" if up == 1.0 else "top"
        page.add_annotation(text=_lines(text), showarrow=False, bgcolor=PAPER, **place)
    here = "" if number == 1 else str(number)  # which plotly leaves out of domains
    corner: Any = {"xref": f"x{here}", "xanchor": "left", "yref": f"y{here} domain", "y": 0.97}
    for at, label in (mark for mark in panel.marks if mark.label):
        look = {"text": label, "textangle": -90, "bgcolor": PAPER, "yanchor": "top"}
        page.add_annotation(x=at, showarrow=False, **look, **corner)


def _lines(text: str) -> str:
    """A text in HTML; of mathematics the figures have no more than a tilde."""
    return text.replace("\n", "<br>").replace("$", "").replace(r"\tilde R", "R\N{COMBINING TILDE}")
