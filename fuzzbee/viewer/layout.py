"""What the viewer shows where: one arrangement for any number of vehicles."""

from typing import Any

from fuzzbee.viewer.sdk import rrb
from fuzzbee.viewer.stream import TIMELINE

WINDOW_S = 60.0  # so much of the curves is shown
FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100
OURS, AUTOPILOT, TRUTH = (64, 150, 255), (255, 140, 40), (70, 200, 100)
GRAVITY, FIELD = (200, 60, 200), (0, 175, 190)
INCLINATION, HEADING = (150, 90, 235), (225, 70, 150)  # their sigmas
AXES = ((235, 70, 70), (70, 180, 80), (80, 120, 250))  # x, y, z; or roll, pitch, heading

Colours = tuple[tuple[int, ...], ...]
# Names and colours of the lines of each plot
LINES: dict[str, tuple[tuple[str, ...], Colours]] = {
    "sigma": (
        ("sigma inclination", "sigma heading", "to autopilot", "to truth"),
        (INCLINATION, HEADING, AUTOPILOT, TRUTH),
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
# Ranges are fixed, so that a quiet filter looks quiet
_PLOTS = {
    "sigma": ("Sigma and difference (°)", (0.0, 50.0)),
    "tilt": ("Roll and pitch (°)", (-180.0, 180.0)),
    "heading": ("Heading (°)", (0.0, 360.0)),
    "rate": ("Rates (°/s)", (-200.0, 200.0)),
    "bias": ("Gyroscope's bias (°/s)", (-3.0, 3.0)),
    "gain": ("Gain K", (0.0, FULL_GAIN)),
    "error": ("Error e", (0.0, 1.0)),
    "confidence": ("Confidence", (0.0, 1.05)),
}


def blueprint() -> Any:
    """Bodies and messages on the left, curves on the right, of all vehicles together."""
    plots = [_plot(name, title, span) for name, (title, span) in _PLOTS.items()]
    states = rrb.StateTimelineView(origin="/state", name="States")
    messages = rrb.TextLogView(origin="/messages", name="Messages")
    left = rrb.Vertical(_bodies(), rrb.Tabs(messages, states), row_shares=[3, 1])
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


def _bodies() -> Any:
    """North is ahead, east to the right, seen from behind and above."""
    return rrb.Spatial3DView(
        origin="/bodies",
        name="Ours blue, autopilot orange, truth green; measured gravity purple, field cyan",
        eye_controls=rrb.EyeControls3D(
            position=(-1.9, 0.0, -1.2), look_target=(0.05, 0.0, 0.1), eye_up=(0.0, 0.0, -1.0)
        ),
        line_grid=False,
    )


def _plot(name: str, title: str, span: tuple[float, float]) -> Any:
    window = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.TimeSeriesView(
        origin=f"/{name}", name=title, time_ranges=[window], axis_y=rrb.ScalarAxis(range=span)
    )
