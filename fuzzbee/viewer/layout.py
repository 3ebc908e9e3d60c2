"""What the viewer shows where, and what does not change: the gain's surface, names, colours."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from estimator.filter.memberships import Memberships
    from estimator.profile import Profile

    GainShape = Memberships | float

TIMELINE = "time"
WINDOW_S = 60.0  # so much of the curves is shown
SURFACE_STEPS = 41
MAX_SIGMA_DEG = 20.0  # top of the axis: up to the 180 of an unknown heading, all else would be flat
FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100

OURS, AUTOPILOT, TRUTH = (64, 150, 255), (255, 160, 40), (90, 210, 110)
SIGMAS = ((110, 110, 230), (190, 90, 200))  # inclination, heading
AXES = ((240, 80, 80), (90, 200, 90), (90, 130, 250))  # x, y, z
GREY = (125, 125, 125)  # readable on a light and on a dark background


def blueprint() -> Any:
    """The attitudes on the left, above the gain's surface; curves on the right."""
    import rerun.blueprint as rrb

    left = rrb.Vertical(
        rrb.Spatial3DView(
            origin="/attitude",
            name="Attitude: fuzzbee blue, autopilot orange, truth green",
            # north ahead, east to the right, seen from behind and above
            eye_controls=rrb.EyeControls3D(
                position=(-4.2, 1.5, -2.6), look_target=(0.0, 1.7, 0.0), eye_up=(0.0, 0.0, -1.0)
            ),
            line_grid=False,
        ),
        gain_view("Gain K over error and its rate"),
        row_shares=[3, 2],
    )
    right = rrb.Grid(
        _curves("/angles", "Roll, pitch, heading (°)"),
        _curves("/error", "Error e, 0 to 1"),
        _curves("/gain", "Gain K"),
        _curves("/confidence", "Confidence"),
        _curves("/off", "Sigma, and turn to the others (°)", (0.0, MAX_SIGMA_DEG)),
        _curves("/rate", "Rates (°/s)"),
        _curves("/bias", "Gyroscope bias (°/s)"),
        rrb.TextLogView(origin="/state", name="States and messages"),
        grid_columns=2,
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[2, 3]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
    )


def gain_view(name: str) -> Any:
    """The gain's surface, from the corner where error and rate are 0."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="/surface",
        name=name,
        eye_controls=rrb.EyeControls3D(
            position=(-0.75, -0.9, 1.35), look_target=(0.5, 0.5, 0.3), eye_up=(0.0, 0.0, 1.0)
        ),
        line_grid=False,
    )


def _curves(origin: str, name: str, span: tuple[float, float] | None = None) -> Any:
    import rerun.blueprint as rrb

    window = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    axis = None if span is None else rrb.ScalarAxis(range=span)
    return rrb.TimeSeriesView(origin=origin, name=name, time_ranges=[window], axis_y=axis)


def vehicle_shape(colour: tuple[int, int, int]) -> Any:
    """A flat body with its nose, in FRD."""
    import rerun as rr

    nose, left, right, tail = (0.7, 0.0, 0.0), (-0.5, -0.45, 0.0), (-0.5, 0.45, 0.0), (-0.3, 0, 0)
    top, below = (-0.35, 0.0, -0.18), (-0.3, 0.0, 0.06)
    corners = [nose, left, right, tail, top, below]
    faces = [(0, 4, 1), (0, 2, 4), (1, 4, 3), (2, 3, 4), (0, 1, 5), (0, 5, 2), (1, 3, 5), (2, 5, 3)]
    shade = (1.0, 0.8, 0.9, 1.0, 1.25, 0.45)
    colours = [[min(255, int(part * tone)) for part in colour] for tone in shade]
    return rr.Mesh3D(vertex_positions=corners, triangle_indices=faces, vertex_colors=colours)


def body_axes() -> Any:
    """Forward red, right green, down blue."""
    import rerun as rr

    return rr.Arrows3D(vectors=0.9 * np.eye(3), colors=AXES, radii=0.012)


def world_axes() -> Any:
    """North and east, at the vehicle's place."""
    import rerun as rr

    return rr.Arrows3D(
        vectors=[(0.5, 0.0, 0.0), (0.0, 0.5, 0.0)],
        origins=[(-1.2, -1.0, 0.8)] * 2,
        colors=GREY,
        radii=0.01,
        labels=["north", "east"],
    )


def gain_shape(profile: "Profile") -> "GainShape":
    """What the surface shows: k1..k22, or the K of a plane.

    A gain that knows the noise has no surface over e itself: the plane lies at the bottom.
    """
    if profile.filter.gain == "fuzzy":
        return profile.k
    return profile.filter.fixed_gain if profile.filter.gain == "fixed" else 1.0


def gain_surface(shape: "GainShape") -> Any:
    """K over (e, its rate) on [0, 1]^2 as a mesh in a unit cube."""
    import rerun as rr

    from estimator.filter.fuzzy import fuzzy_gain

    grid = np.linspace(0.0, 1.0, SURFACE_STEPS)
    if isinstance(shape, float):
        height = np.full((SURFACE_STEPS, SURFACE_STEPS), min(1.0, (shape - 1.0) / 100.0))
    else:
        height = np.array([[fuzzy_gain(shape, e, rate) for rate in grid] for e in grid]) / 100.0
    e, rate = np.meshgrid(grid, grid, indexing="ij")
    corners = np.stack([e, rate, height], axis=-1).reshape(-1, 3)
    low, high = np.array([40, 60, 140]), np.array([250, 210, 70])
    colours = (low + height.reshape(-1, 1) * (high - low)).astype(np.uint8)
    return rr.Mesh3D(vertex_positions=corners, triangle_indices=_triangles(), vertex_colors=colours)


def _triangles() -> Any:
    """Two for each cell of the grid, each from both sides."""
    steps = SURFACE_STEPS
    corner = np.arange(steps * steps).reshape(steps, steps)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    upper = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.concatenate([upper, upper[:, ::-1]])


def surface_axes() -> Any:
    """What the surface's directions mean."""
    import rerun as rr

    return rr.Arrows3D(
        vectors=[(1.1, 0, 0), (0, 1.1, 0), (0, 0, 1.1)],
        colors=GREY,
        radii=0.006,
        labels=["error e", "rate of e", f"K to {FULL_GAIN:g}"],
    )
