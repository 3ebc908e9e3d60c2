"""A search in the viewer: what is shown where, and the shapes in it."""

from typing import Any

import numpy as np

from estimator.arrays import Floats
from estimator.filter.memberships import TERMS, Memberships, Triangle, fuzzy_sets
from fuzzbee.viewer.layout import FULL_GAIN, GREY
from fuzzbee.viewer.sdk import rr, rrb
from tuning.space import Space, bounds, encode

CYCLE = "cycle"
ROWS_ASPECT = 1.75  # width of a parameter's bounds over the height of all rows
LABEL_DROP = 0.6  # Rerun draws a label below its place; this lifts it, in rows
NAME_SHARE = 0.006  # half the width of a character, as a share of a row's width
SPREAD = 0.7  # share of a row's height over which the members are spread
BEST, MEDIAN, MEAN = (230, 60, 90), (80, 150, 255), (130, 110, 200)
GOOD, BAD = np.array([255, 150, 30]), np.array([70, 110, 220])  # members by rank of cost
TERM_COLOURS = ((80, 130, 240), (60, 180, 110), (190, 160, 30), (240, 130, 50), (230, 70, 80))
SETS_WIDTH, SETS_HEIGHT, SETS_GAP = 7.0, 3.0, 1.0
SURFACE_STEPS = 41


def blueprint(space: Space, *, bees: bool) -> Any:
    """Cost and members on the left; gain and fuzzy sets of the best member on the right."""
    members, width = "Food sources" if bees else "Members", row_width(space)
    left = rrb.Vertical(
        rrb.TimeSeriesView(
            origin="/cost",
            name="Cost J by cycle",
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
        ),
        rrb.Spatial2DView(
            origin="/members",
            name=f"{members} within the bounds: cheap orange, costly blue; best red, base grey",
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-(0.12 + 2.0 * name_share(space)) * width, 1.08 * width),
                y_range=(-1.0, space.dimensions + 0.6),
            ),
        ),
        row_shares=[2, 3],
    )
    counts = [
        rrb.TextDocumentView(origin="/progress", name="Progress"),
        rrb.BarChartView(
            origin="/trials", name="Trials in vain, by food source" if bees else "Cost, by member"
        ),
    ]
    right = rrb.Vertical(*counts)
    if "k1" in space.names:
        gain = gain_view("Gain K of the best so far")
        below = rrb.Horizontal(*counts, column_shares=[2, 3])
        right = rrb.Vertical(gain, _sets_view(), below, row_shares=[3, 2, 2])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=CYCLE, play_state="following"),
    )


def gain_view(name: str) -> Any:
    """The gain's surface, from the corner where error and rate are 0."""
    return rrb.Spatial3DView(
        origin="/surface",
        name=name,
        eye_controls=rrb.EyeControls3D(
            position=(-0.75, -0.9, 1.35), look_target=(0.5, 0.5, 0.3), eye_up=(0.0, 0.0, 1.0)
        ),
        line_grid=False,
    )


def gain_surface(k: Memberships) -> Any:
    """K over (e, its rate) on [0, 1]^2 as a mesh in a unit cube."""
    from estimator.filter.fuzzy import fuzzy_gain

    grid = np.linspace(0.0, 1.0, SURFACE_STEPS)
    height = np.array([[fuzzy_gain(k, e, rate) for rate in grid] for e in grid]) / 100.0
    e, rate = np.meshgrid(grid, grid, indexing="ij")
    corners = np.stack([e, rate, height], axis=-1).reshape(-1, 3)
    low, high = np.array([40, 60, 140]), np.array([250, 210, 70])
    colours = (low + height.reshape(-1, 1) * (high - low)).astype(np.uint8)
    return rr.Mesh3D(vertex_positions=corners, triangle_indices=_mesh(), vertex_colors=colours)


def _mesh() -> Any:
    """Two for each cell of the grid, each from both sides."""
    steps = SURFACE_STEPS
    corner = np.arange(steps * steps).reshape(steps, steps)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    upper = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.concatenate([upper, upper[:, ::-1]])


def surface_axes() -> Any:
    """What the surface's directions mean."""
    return rr.Arrows3D(
        vectors=[(1.1, 0, 0), (0, 1.1, 0), (0, 0, 1.1)],
        colors=GREY,
        radii=0.006,
        labels=["error e", "rate of e", f"K to {FULL_GAIN:g}"],
    )


def _sets_view() -> Any:
    return rrb.Spatial2DView(
        origin="/sets",
        name="Fuzzy sets of the best so far (base grey)",
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-0.3, 2.0 * SETS_WIDTH + SETS_GAP + 0.3), y_range=(-SETS_HEIGHT - 0.6, 1.0)
        ),
    )


def bounds_frame(space: Space) -> Any:
    """A line for each parameter, from its lower to its upper bound."""
    width = row_width(space)
    rows = [[(0.0, float(i)), (width, float(i))] for i in range(space.dimensions)]
    return rr.LineStrips2D(rows, colors=[GREY], radii=rr.Radius.ui_points(0.3))


def bounds_names(space: Space) -> Any:
    """Names on the left, bounds at the ends."""
    texts, places, width = [], [], row_width(space)
    for i, name in enumerate(space.names):
        texts += [name.rpartition(".")[2], f"{space.lower[i]:.3g}", f"{space.upper[i]:.3g}"]
        y = i - LABEL_DROP
        places += [(-(0.08 + name_share(space)) * width, y), (-0.035 * width, y), (1.04 * width, y)]
    return labels(places, texts, [MEDIAN, GREY, GREY] * space.dimensions)


def name_share(space: Space) -> float:
    """Half the width of the longest name, in row widths."""
    return NAME_SHARE * max(len(name.rpartition(".")[2]) for name in space.names)


def row_width(space: Space) -> float:
    """Width in which the bounds of a parameter are drawn; rows are 1 apart."""
    return ROWS_ASPECT * space.dimensions


def labels(places: list[Any], texts: list[str], colours: list[Any]) -> Any:
    """Text at places, without a point."""
    return rr.Points2D(
        places, labels=texts, colors=colours, radii=rr.Radius.ui_points(0.0), show_labels=True
    )


def members(space: Space, values: Floats, costs: Floats) -> Any:
    """A dot for each member and parameter; the cheaper, the higher in its row and the brighter."""
    rank = np.argsort(np.argsort(costs)) / max(1, len(costs) - 1)
    x = row_width(space) * shares(space, values)
    y = np.arange(space.dimensions)[None, :] + SPREAD * (rank[:, None] - 0.5)
    colours = (GOOD + rank[:, None] * (BAD - GOOD)).astype(np.uint8)
    order = np.argsort(-rank)  # the best on top
    return rr.Points2D(
        np.stack([x, np.broadcast_to(y, x.shape)], axis=-1)[order].reshape(-1, 2),
        colors=np.repeat(colours[order], space.dimensions, axis=0),
        radii=rr.Radius.ui_points(1.6),
    )


def position(space: Space, values: Floats, colour: tuple[int, int, int], width: float) -> Any:
    """One set of values (D,) as a line from row to row."""
    x = row_width(space) * shares(space, values[None, :])[0]
    strip = np.stack([x, np.arange(space.dimensions)], axis=-1)
    return rr.LineStrips2D([strip], colors=[colour], radii=rr.Radius.ui_points(width))


def shares(space: Space, values: Floats) -> Floats:
    """Values (N, D) between their bounds, 0 to 1, in search coordinates."""
    lower, upper = bounds(space)
    found: Floats = (encode(space, values) - lower) / (upper - lower)
    return found


def fuzzy_set_lines(k: Memberships, *, base: bool) -> Any:
    """The triangles of both inputs, and beside them those of the output."""
    strips = [
        [(x0 + SETS_WIDTH * corner / full, -height) for corner, height in shape]
        for x0, full, shape in _triangles(k)
    ]
    colours = [GREY] if base else list(TERM_COLOURS) * 2
    return rr.LineStrips2D(strips, colors=colours, radii=rr.Radius.ui_points(0.6 if base else 1.5))


def fuzzy_set_names(k: Memberships) -> Any:
    """The terms' names over their peaks; every other one lower, as two peaks may coincide."""
    places = [
        (x0 + SETS_WIDTH * shape[1][0] / full, -SETS_HEIGHT * (1.12 - 0.2 * (n % 2)))
        for n, (x0, full, shape) in enumerate(_triangles(k))
    ]
    return labels(places, list(TERMS) * 2, list(TERM_COLOURS) * 2)


def fuzzy_set_axes() -> Any:
    """Labels of the two axes that the sets stand on."""
    texts = ["0", "error e, and its rate", "1", "0", "k_op, where K = 1 + k_op", "100"]
    starts = (0.0, SETS_WIDTH + SETS_GAP)
    places = [(x0 + part * SETS_WIDTH, 0.25) for x0 in starts for part in (0.0, 0.5, 1.0)]
    return labels(places, texts, [GREY] * 6)


def _triangles(k: Memberships) -> list[tuple[float, float, tuple[tuple[float, float], ...]]]:
    """For each triangle: where its axis begins, the axis's full scale, corners with heights."""

    def shape(corners: Triangle) -> tuple[tuple[float, float], ...]:
        return tuple(zip(corners, (0.0, SETS_HEIGHT, 0.0), strict=True))

    sets = fuzzy_sets(k)
    inputs = [(0.0, 1.0, shape(corners)) for corners in sets.inputs]
    beside = SETS_WIDTH + SETS_GAP
    return inputs + [(beside, 100.0, shape(corners)) for corners in sets.output]
