"""The gain over error and its rate, as a surface; where a vehicle stands on it is a point."""

from typing import Any

import numpy as np

from estimator.filter.memberships import Memberships
from estimator.profile import Profile
from fuzzbee.viewer.sdk import rr, rrb

GainShape = Memberships | float


SURFACE_STEPS = 41
FULL_GAIN = 101.0  # K = 1 + k_op, k_op up to 100
GREY = (125, 125, 125)  # readable on a light and on a dark background


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


def gain_shape(profile: Profile) -> GainShape:
    """What the surface shows: k1..k22, or the K of a plane.

    A gain that knows the noise has no surface over e itself: the plane lies at the bottom.
    """
    if profile.filter.gain == "fuzzy":
        return profile.k
    return profile.filter.fixed_gain if profile.filter.gain == "fixed" else 1.0


def gain_surface(shape: GainShape) -> Any:
    """K over (e, its rate) on [0, 1]^2 as a mesh in a unit cube."""
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
    return rr.Arrows3D(
        vectors=[(1.1, 0, 0), (0, 1.1, 0), (0, 0, 1.1)],
        colors=GREY,
        radii=0.006,
        labels=["error e", "rate of e", f"K to {FULL_GAIN:g}"],
    )
