"""The axes of a frame as the body sees them, which turn vectors by scalar products."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import dot
from estimator.types import Quaternion, Vec3


class FrameAxes(NamedTuple):
    """The three axes of a frame, unit vectors in FRD: the rows of the rotation body to frame.

    Only of a level frame they lie north (of any heading), east and down.
    """

    north: Vec3
    east: Vec3
    down: Vec3


@inlined
def axes_of(q_frame_frd: Quaternion) -> FrameAxes:
    """The axes of the frame that the quaternion takes the body's vectors to."""
    w, x, y, z = q_frame_frd
    return FrameAxes(
        north=(1.0 - 2.0 * y * y - 2.0 * z * z, 2.0 * (x * y - w * z), 2.0 * (w * y + x * z)),
        east=(2.0 * (w * z + x * y), 1.0 - 2.0 * z * z - 2.0 * x * x, 2.0 * (y * z - w * x)),
        down=down_of(q_frame_frd),
    )


@inlined
def down_of(q_ab: Quaternion) -> Vec3:
    """The third axis of frame a, seen from frame b."""
    w, x, y, z = q_ab
    return (2.0 * (x * z - w * y), 2.0 * (w * x + y * z), 1.0 - 2.0 * x * x - 2.0 * y * y)


@inlined
def to_frame(axes: FrameAxes, v: Vec3) -> Vec3:
    """A body's vector in the frame."""
    return (dot(axes.north, v), dot(axes.east, v), dot(axes.down, v))


@inlined
def to_body(axes: FrameAxes, v: Vec3) -> Vec3:
    """A frame's vector in the body."""
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )
