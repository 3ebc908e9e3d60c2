"""Curves of one vehicle, sent in batches: a viewer takes in a batch as fast as a point."""

from collections.abc import Sequence
from math import nan

from estimator.types import Vec3
from fuzzbee.viewer.layout import TIMELINE
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import ViewerStream

# A curve ends so much before the present at most; more where there are many vehicles.
BATCH_S, LONGEST_BATCH_S = 4.0, 10.0
GAP_DEG = 180.0  # an angle that jumps by more has wrapped round


class Curves:
    """Points under ``path`` that wait to be sent."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._time_s = 0.0
        self._since_s: float | None = None
        self._times: dict[str, list[float]] = {}
        self._values: dict[str, list[list[float]]] = {}
        self._last: dict[str, Sequence[float]] = {}

    def begin(self, time_s: float) -> None:
        """Set the time (Unix, s) of the points that follow."""
        self._time_s = time_s
        if self._since_s is None:
            self._since_s = time_s

    def add(self, name: str, values: Sequence[float]) -> None:
        """A point of one or several lines."""
        self._times.setdefault(name, []).append(self._time_s)
        self._values.setdefault(name, []).append(list(values))

    def add_angles(self, angles_deg: Sequence[Vec3]) -> None:
        """Rolls and pitches, and headings, of several estimates; a gap where an angle wraps."""
        self._add_cut("tilt", [x for angles in angles_deg for x in angles[:2]])
        self._add_cut("heading", [angles[2] for angles in angles_deg])

    def _add_cut(self, name: str, angles_deg: list[float]) -> None:
        last = self._last.get(name, angles_deg)
        self._last[name] = angles_deg
        pairs = zip(last, angles_deg, strict=True)
        self.add(name, [nan if abs(now - was) > GAP_DEG else now for was, now in pairs])

    def is_full(self, vehicles: int) -> bool:
        """Whether it is time to send, with so many vehicles; also if the clock was set back."""
        batch_s = min(LONGEST_BATCH_S, BATCH_S * vehicles)
        return self._since_s is not None and not 0.0 <= self._time_s - self._since_s < batch_s

    def flush(self, stream: ViewerStream) -> None:
        """Send all that wait."""
        for name, times in self._times.items():
            column = rr.TimeColumn(TIMELINE, timestamp=times)
            stream.curves(f"{self._path}/{name}", column, self._values[name])
        self._times.clear()
        self._values.clear()
        self._since_s = None
