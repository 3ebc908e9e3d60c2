"""A search as a Rerun recording, while it runs. The view never changes the search."""

from typing import Any

import numpy as np

from fuzzbee.notify import notify
from fuzzbee.viewer.stream import CLOSED, ViewerStream, rr, rrb
from tuning.search import Search
from tuning.space import Space, bounds, encode

CYCLE = "cycle"
CURVES = {"best": (230, 60, 90), "median": (80, 150, 255), "mean": (130, 110, 200)}


def blueprint() -> Any:
    """Cost above the best member's values, both by cycle."""
    cost = rrb.TimeSeriesView(origin="/cost", name="Cost J by cycle")
    best = rrb.TimeSeriesView(
        origin="/best",
        name="The best member's values: 0 is the lower bound, 1 the upper",
        axis_y=rrb.ScalarAxis(range=(-0.05, 1.05)),
    )
    return rrb.Blueprint(
        rrb.Vertical(cost, best),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=CYCLE, play_state="following"),
    )


class SearchView(ViewerStream):
    """Draws a search in ``space`` after its cycles."""

    def __init__(self, space: Space, view: str | None, rrd: str | None) -> None:
        self._space = space
        self._drawn_cycles = 0
        super().__init__(blueprint(), view, rrd)
        curves = rr.SeriesLines(names=list(CURVES), colors=list(CURVES.values()))
        self.recording.log("/cost", curves, static=True)
        names = [parameter.address[1] for parameter in space]
        self.recording.log("/best", rr.SeriesLines(names=names), static=True)

    def show(self, search: Search) -> None:
        """Draw the latest cycles, if there are some."""
        if self.take_loss():
            notify(f"viewer {CLOSED}")
        if self.is_wanted and search.cycles > self._drawn_cycles:
            self._draw(search)

    def show_end(self, search: Search, *, stay: bool) -> None:
        """Draw the end; leave the viewer open, and ``stay`` until somebody closes it."""
        if search.cycles > self._drawn_cycles:
            self._draw(search)
        self.finish()
        self.require_whole()
        if stay:
            self.stay_open()

    def _draw(self, search: Search) -> None:
        """All cycles since the last drawing, with --resume those of the earlier run; the best."""
        new = search.history[self._drawn_cycles :]
        costs = [[p.best_cost, p.median_cost, p.mean_cost] for p in new]
        cycles = rr.TimeColumn(CYCLE, sequence=[p.cycles for p in new])
        recording = self.recording
        recording.send_columns("/cost", indexes=[cycles], columns=rr.Scalars.columns(scalars=costs))
        lower, upper = bounds(self._space)
        values = encode(self._space, np.asarray(search.best_values))
        recording.set_time(CYCLE, sequence=search.cycles)
        recording.log("/best", rr.Scalars(((values - lower) / (upper - lower)).tolist()))
        self._drawn_cycles = search.cycles
