"""What the viewer shows where."""

from collections.abc import Sequence
from typing import Any

from fuzzbee.viewer.horizon import SKY, X_RANGE, Y_RANGE
from fuzzbee.viewer.sdk import rrb

TIMELINE = "time"
WINDOW_S = 60.0  # so much of the curves is shown
MOST_VEHICLES = 9  # shown side by side; more are too small to read

MOST_PLOTS = 2  # on a page of one vehicle among several

FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100

GREY = (125, 125, 125)  # readable on a light and on a dark background
OURS, AUTOPILOT, TRUTH = (64, 150, 255), (255, 140, 40), (70, 200, 100)
HORIZON, HEADING = (150, 90, 235), (225, 70, 150)  # their sigmas
AXES = ((235, 70, 70), (70, 180, 80), (80, 120, 250))  # x, y, z; or roll, pitch, heading

# Fixed, so that a quiet filter looks quiet: (origin, title that says the colours, range)
PLOTS = (
    ("tilt", "Roll red, pitch green (°)", (-180.0, 180.0)),
    ("heading", "Heading (°)", (0.0, 360.0)),
    ("rate", "Rates (°/s)", (-200.0, 200.0)),
    ("bias", "Bias (°/s)", (-3.0, 3.0)),
    ("gain", "Gain K", (0.0, FULL_GAIN)),
    ("error", "Error e", (0.0, 1.0)),
    ("confidence", "Confidence", (0.0, 1.05)),
)
SIGMA = (
    "off",
    "±: horizon violet, heading pink; off autopilot orange, truth green",
    (0.0, 50.0),
)
# Names and colours of the lines of each
LINES: dict[str, tuple[tuple[str, ...], tuple[tuple[int, ...], ...]]] = {
    "off": (
        ("horizon", "heading", "to autopilot", "to truth"),
        (HORIZON, HEADING, AUTOPILOT, TRUTH),
    ),
    "tilt": (
        ("roll", "pitch", "autopilot's roll", "autopilot's pitch", "true roll", "true pitch"),
        (AXES[0], AXES[1], *((*axis, 130) for axis in AXES[:2] * 2)),
    ),
    "heading": (("heading", "autopilot's", "true"), (AXES[2], AUTOPILOT, TRUTH)),
    "rate": (("x", "y", "z"), AXES),
    "bias": (("x", "y", "z"), AXES),
    "gain": (("K",), (AUTOPILOT,)),
    "error": (("e",), (OURS,)),
    "confidence": (("gravity", "field"), (OURS, AUTOPILOT)),
}


def blueprint(vehicles: Sequence[str] = ()) -> Any:
    """A page for each vehicle; if there are several, all their horizons come first."""
    pages = [_page(name, is_alone=len(vehicles) == 1) for name in vehicles]
    if len(pages) > 1:
        everything = rrb.Grid(
            *(_horizon(name) for name in vehicles),
            _messages(),
            name=f"all {len(vehicles)}",
        )
        pages = [rrb.Tabs(everything, *pages)]
    return rrb.Blueprint(
        *(pages or [_messages()]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )


def _page(name: str, *, is_alone: bool) -> Any:
    """The horizon large; beside it the bodies, how far to trust them, and all else in tabs.

    One of several has few tabs: the more views there are, the longer a browser takes them in.
    """
    plots = PLOTS if is_alone else PLOTS[:MOST_PLOTS]
    rest = [_curves(f"/{name}/{origin}", title, span) for origin, title, span in plots]
    if is_alone:
        states = rrb.StateTimelineView(origin=f"/{name}/state", name="States")
        rest += [states, _messages()]
    origin, title, span = SIGMA
    right = rrb.Vertical(
        _bodies(name),
        _curves(f"/{name}/{origin}", title, span),
        rrb.Tabs(*rest),
        row_shares=[4, 3, 3],
    )
    return rrb.Horizontal(_horizon(name), right, column_shares=[3, 2], name=f"vehicle {name}")


def _horizon(name: str) -> Any:
    return rrb.Spatial2DView(
        origin=f"/{name}/horizon",
        name=f"Vehicle {name}",
        background=SKY,
        visual_bounds=rrb.VisualBounds2D(x_range=X_RANGE, y_range=Y_RANGE),
        titlebar=False,
    )


def _bodies(name: str) -> Any:
    return rrb.Spatial3DView(
        origin=f"/{name}/bodies",
        name="Ours blue, autopilot orange, truth green; g purple, field cyan",
        # north ahead, east to the right, seen from behind and above
        eye_controls=rrb.EyeControls3D(
            position=(-2.0, 0.0, -1.35), look_target=(0.05, 0.0, 0.1), eye_up=(0.0, 0.0, -1.0)
        ),
        line_grid=False,
    )


def _messages() -> Any:
    return rrb.TextLogView(origin="/messages", name="Messages")


def _curves(origin: str, name: str, span: tuple[float, float]) -> Any:
    """Curves without a legend, which would cover them: the title says the colours."""
    window = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        time_ranges=[window],
        axis_y=rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(visible=False),
    )
