"""A search in the Rerun viewer, while it runs. The view never changes the search."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fuzzbee.say import say
from fuzzbee.tune.plan import Plan
from fuzzbee.viewer.sdk import rr, rrb
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream
from tuning.objective import Scores
from tuning.search import Search
from tuning.space import Space, bounds, encode

PERIOD_S = 0.25  # often enough for the eye; drawing more would take time from the search
CYCLE = "cycle"
CURVES = {"best": (230, 60, 90), "median": (80, 150, 255), "mean": (130, 110, 200)}


def blueprint(*, bees: bool) -> Any:
    """Cost and the best member's values on the left; progress and bars on the right."""
    bars = "Trials in vain, by food source" if bees else "Cost, by member"
    left = rrb.Vertical(
        rrb.TimeSeriesView(origin="/cost", name="Cost J by cycle"),
        rrb.TimeSeriesView(
            origin="/best",
            name="The best member's values: 0 is the lower bound, 1 the upper",
            axis_y=rrb.ScalarAxis(range=(-0.05, 1.05)),
        ),
    )
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/progress", name="Progress"),
        rrb.BarChartView(origin="/trials", name=bars),
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=CYCLE, play_state="following"),
    )


class SearchView:
    """Draws a search of ``plan`` after its cycles, at most every ``PERIOD_S``.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    def __init__(
        self, options: ViewerOptions, plan: Plan, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        bees = plan.options.algorithm == "abc"
        self._plan = plan
        self._space = plan.task.space
        self._now_s = now_s
        self._due_s = 0.0
        self._drawn_cycles = 0
        self.stream = ViewerStream(options, lambda: blueprint(bees=bees))
        self.stream.lines("/cost", list(CURVES), list(CURVES.values()))
        names = [name.rpartition(".")[2] for name in self._space.names]
        self.stream.static("/best", rr.SeriesLines(names=names))

    def show(self, search: Search) -> None:
        """Draw the latest cycle, if it is due."""
        if self.stream.take_loss():
            say(f"viewer {CLOSED}")
        if not self.stream.is_wanted:
            return
        now_s = self._now_s()
        if search.cycles > self._drawn_cycles and now_s >= self._due_s:
            self._due_s = now_s + PERIOD_S
            self._draw(search)

    def finish(self, search: Search, before: Scores, after: Scores) -> None:
        """Draw the end, with the scores of base and result, and leave the viewer open."""
        if search.population is not None:
            self._draw(search)
        self._tell(search, _scores(before, after))
        self.stream.finish()
        self.stream.require_whole()

    def close(self) -> None:
        """End the viewer."""
        self.stream.close()

    def _draw(self, search: Search) -> None:
        assert search.population is not None
        self._draw_costs(search)
        self.stream.at(CYCLE, sequence=search.cycles)
        self.stream.log("/best", rr.Scalars(_shares(self._space, search.best_values)))
        _, costs, failures = search.population
        self.stream.log("/trials", rr.BarChart(costs if failures is None else failures))
        self._tell(search)
        self._drawn_cycles = search.cycles

    def _draw_costs(self, search: Search) -> None:
        """Draw all cycles since the last drawing; after --resume also those of the earlier run."""
        new = search.history[self._drawn_cycles :]
        if new:
            costs = [[p.best_cost, p.median_cost, p.mean_cost] for p in new]
            cycles = rr.TimeColumn(CYCLE, sequence=[p.cycles for p in new])
            self.stream.send("/cost", cycles, rr.Scalars.columns(scalars=costs))

    def _tell(self, search: Search, scores: Sequence[tuple[str, str]] = ()) -> None:
        text = _table(self._plan.options.algorithm, [*_progress(self._plan, search), *scores])
        self.stream.log("/progress", rr.TextDocument(text, media_type="text/markdown"))


def _shares(space: Space, values: Any) -> list[float]:
    """Values (D,) between their bounds, 0 to 1, in search coordinates."""
    lower, upper = bounds(space)
    shares: list[float] = ((encode(space, np.asarray(values)) - lower) / (upper - lower)).tolist()
    return shares


def _progress(plan: Plan, search: Search) -> list[tuple[str, str]]:
    """Rows that say how far the search is and how good its best is."""
    options = plan.options
    cycles = _count_text(search.cycles, options.cycles if options.algorithm == "abc" else None)
    rows = [
        ("cycles", cycles),
        ("trials", _count_text(search.evaluations, options.budget)),
        ("best J", f"{search.best_cost:.4f}"),
    ]
    if search.history:
        rows.append(("median J", f"{search.history[-1].median_cost:.4f}"))
    if search.population is not None and search.population.failures is not None:
        rows.append(
            ("most in vain", _count_text(int(search.population.failures.max()), options.limit))
        )
    return rows


def _scores(before: Scores, after: Scores) -> list[tuple[str, str]]:
    """Rows with the scores before and after, by the live filter's kernels."""
    return [
        ("tuned on", f"{before.tuning:.4f} → {after.tuning:.4f}"),
        ("held out", f"{before.held_out:.4f} → {after.held_out:.4f}"),
    ]


def _table(title: str, rows: Sequence[tuple[str, str]]) -> str:
    lines = [f"| {title} | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)]
    return "\n".join(lines) + "\n"


def _count_text(count: int, whole: int | None) -> str:
    text = f"{count:,}" if whole is None else f"{count:,} of {whole:,}"
    return text.replace(",", " ")
