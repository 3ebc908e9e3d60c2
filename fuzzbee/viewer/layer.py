"""One layer of lines in the viewer, of which only what has changed is sent."""

from collections.abc import Sequence
from typing import Any

from fuzzbee.viewer.bodies import Line
from fuzzbee.viewer.horizon import Strip
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import ViewerStream

Lines = Sequence[Strip] | Sequence[Line]

# All is sent again so often, for a page that was opened in the meantime.
WHOLE_EVERY_US = 5_000_000


class Layer:
    """Lines under ``path``; those of a higher ``order`` cover others in two dimensions."""

    def __init__(self, path: str, order: int | None = None) -> None:
        self._path = path
        self._order = {} if order is None else {"draw_order": order}
        self._shape: Any = rr.LineStrips3D if order is None else rr.LineStrips2D
        self._points: list[Any] | None = None
        self._style: dict[str, Any] = {}
        self._whole_us = 0

    def draw(self, stream: ViewerStream, lines: Lines, now_us: int) -> None:
        """Show these lines from now on."""
        points = [line.points for line in lines]
        style = _style(lines)
        is_old = not 0 <= now_us - self._whole_us < WHOLE_EVERY_US
        if is_old or style != self._style:
            stream.log(self._path, self._shape(points, **style, **self._order))
            self._whole_us = now_us
        elif points != self._points:
            stream.log(self._path, self._shape.from_fields(strips=points))
        self._points, self._style = points, style


def _style(lines: Lines) -> dict[str, Any]:
    """Radii and colours of the lines; a single one where all have the same."""
    radii = [line.radius for line in lines]
    colours = [line.colour for line in lines]
    return {
        "radii": radii[:1] if len(set(radii)) == 1 else radii,
        "colors": colours[:1] if len(set(colours)) == 1 else colours,
    }
