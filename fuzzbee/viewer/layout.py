"""What the viewer shows where: one arrangement for any number of vehicles."""

from typing import Any, NamedTuple

from fuzzbee.viewer.stream import TIMELINE, rrb

Colour = tuple[int, ...]

WINDOW_S = 60.0  # so much of the curves is shown
OURS, AUTOPILOT, TRUTH = (64, 150, 255), (255, 140, 40), (70, 200, 100)
GRAVITY, FIELD = (200, 60, 200), (0, 175, 190)
X, Y, Z = (235, 70, 70), (70, 180, 80), (80, 120, 250)  # or roll, pitch, heading


class Plot(NamedTuple):
    """A plot; its range is fixed, so that a quiet filter looks quiet."""

    title: str
    span: tuple[float, float]
    lines: dict[str, Colour]  # ours
    of_others: tuple[str, ...] = ()  # those of somebody else's attitude


_SIGMAS: dict[str, Colour] = {"sigma inclination": (150, 90, 235), "sigma heading": (225, 70, 150)}
PLOTS = {
    "sigma": Plot("Sigma and difference (°)", (0.0, 50.0), _SIGMAS, ("difference",)),
    "tilt": Plot("Roll and pitch (°)", (-180.0, 180.0), {"roll": X, "pitch": Y}, ("roll", "pitch")),
    "heading": Plot("Heading (°)", (0.0, 360.0), {"heading": Z}, ("heading",)),
    "rate": Plot("Rates (°/s)", (-200.0, 200.0), {"x": X, "y": Y, "z": Z}),
    "bias": Plot("Gyroscope's bias (°/s)", (-3.0, 3.0), {"x": X, "y": Y, "z": Z}),
    "gain": Plot("Gain K", (0.0, 101.0), {"K": AUTOPILOT}),  # 1 + k_op, k_op up to 100
    "error": Plot("Error e", (0.0, 1.0), {"e": OURS}),
    "confidence": Plot("Confidence", (0.0, 1.05), {"gravity": OURS, "field": AUTOPILOT}),
}


def blueprint() -> Any:
    """Bodies and messages on the left, curves on the right, of all vehicles together."""
    boundary = rrb.TimeRangeBoundary
    window = rrb.VisibleTimeRange(
        TIMELINE,
        start=boundary.cursor_relative(seconds=-WINDOW_S),
        end=boundary.cursor_relative(),
    )
    plots = [
        rrb.TimeSeriesView(
            origin=f"/{name}",
            name=plot.title,
            time_ranges=[window],
            axis_y=rrb.ScalarAxis(range=plot.span),
        )
        for name, plot in PLOTS.items()
    ]
    # North is ahead, east to the right, seen from behind and above
    eye = rrb.EyeControls3D(
        position=(-1.9, 0.0, -1.2), look_target=(0.05, 0.0, 0.1), eye_up=(0.0, 0.0, -1.0)
    )
    bodies = rrb.Spatial3DView(
        origin="/bodies",
        name="Ours blue, autopilot orange, truth green; measured gravity purple, field cyan",
        eye_controls=eye,
        line_grid=False,
    )
    states = rrb.StateTimelineView(origin="/state", name="States")
    messages = rrb.TextLogView(origin="/messages", name="Messages")
    left = rrb.Vertical(bodies, rrb.Tabs(messages, states), row_shares=[3, 1])
    right = rrb.Vertical(*plots[:3], rrb.Tabs(*plots[3:]))
    return rrb.Blueprint(
        rrb.Horizontal(left, right),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_layout=False,
        auto_views=False,
    )
