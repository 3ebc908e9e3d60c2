"""One layer of lines in the viewer, of which only what has changed is sent."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fuzzbee.viewer.stream import rerun

if TYPE_CHECKING:
    from fuzzbee.viewer.bodies import Line
    from fuzzbee.viewer.horizon import Strip
    from fuzzbee.viewer.stream import ViewerStream

    Lines = Sequence[Strip] | Sequence[Line]

# All is sent again so often, for a page that was opened in the meantime.
WHOLE_EVERY_US = 5_000_000


class Layer:
    """Lines under ``path``; those of a higher ``order`` cover others in two dimensions."""

    def __init__(self, path: str, order: int | None = None) -> None:
        self._path = path
        self._order = order
        self._points: list[Any] | None = None
        self._style: tuple[Any, Any] | None = None
        self._whole_us = 0

    def draw(self, stream: "ViewerStream", lines: "Lines", now_us: int) -> None:
        """Show these lines from now on."""
        points = [line.points for line in lines]
        style = _style(lines)
        is_old = not 0 <= now_us - self._whole_us < WHOLE_EVERY_US
        if is_old or style != self._style:
            stream.log(self._path, self._whole(points, style))
            self._whole_us = now_us
        elif points != self._points:
            stream.log(self._path, self._shape.from_fields(strips=points))
        self._points, self._style = points, style

    @property
    def _shape(self) -> Any:
        rr = rerun()
        return rr.LineStrips3D if self._order is None else rr.LineStrips2D

    def _whole(self, points: list[Any], style: tuple[Any, Any]) -> Any:
        radii, colours = style
        order = {} if self._order is None else {"draw_order": self._order}
        return self._shape(points, radii=radii, colors=colours, **order)


def _style(lines: "Lines") -> tuple[Any, Any]:
    """Radii and colours; one for all where they are equal, however many lines there will be."""
    radii = [line.radius for line in lines]
    colours = [line.colour for line in lines]
    return (
        radii[:1] if len(set(radii)) == 1 else radii,
        colours[:1] if len(set(colours)) == 1 else colours,
    )
