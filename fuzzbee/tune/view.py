"""A search in the Rerun viewer, while it runs. The view never changes the search."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from estimator.filter.memberships import Memberships
from estimator.profile import Profile
from fuzzbee.say import say
from fuzzbee.tune import layout
from fuzzbee.tune.plan import Plan
from fuzzbee.viewer.layout import GREY
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream
from tuning.objective import Scores, profile_with, values_of
from tuning.search import Population, Search

PERIOD_S = 0.25  # often enough for the eye; drawing more would take time from the search
CURVES = {"best": layout.BEST, "median": layout.MEDIAN, "mean": layout.MEAN}


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
        self._drawn_best = np.inf
        self.stream = ViewerStream(options, lambda: layout.blueprint(self._space, bees=bees))
        self._introduce()

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

    def _introduce(self) -> None:
        """Draw what does not change: names, bounds, the base profile."""
        space, base = self._space, self._plan.task.base
        self.stream.lines("/cost", list(CURVES), list(CURVES.values()))
        self.stream.static("/members/bounds", layout.bounds_frame(space))
        self.stream.static("/members/names", layout.bounds_names(space))
        start = values_of(space, base)
        self.stream.static("/members/base", layout.position(space, start, GREY, 1.0))
        if self._tunes_memberships:
            self.stream.static("/surface", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
            self.stream.static("/surface/axes", layout.surface_axes())
            self.stream.static("/sets/axes", layout.fuzzy_set_axes())
            self.stream.static("/sets/base", layout.fuzzy_set_lines(base.k, base=True))
            self.stream.at(layout.CYCLE, sequence=0)
            self._draw_sets(base.k)

    @property
    def _tunes_memberships(self) -> bool:
        """Whether the memberships are among what is tuned."""
        return "k1" in self._space.names

    def _draw(self, search: Search) -> None:
        assert search.population is not None
        self._draw_costs(search)
        self.stream.at(layout.CYCLE, sequence=search.cycles)
        self._draw_members(search.population)
        if search.best_cost < self._drawn_best:
            self._drawn_best = search.best_cost
            self._draw_best(search)
        self._tell(search)
        self._drawn_cycles = search.cycles

    def _draw_costs(self, search: Search) -> None:
        """Draw all cycles since the last drawing; after --resume also those of the earlier run."""
        new = search.history[self._drawn_cycles :]
        if new:
            costs = [[p.best_cost, p.median_cost, p.mean_cost] for p in new]
            cycles = rr.TimeColumn(layout.CYCLE, sequence=[p.cycles for p in new])
            self.stream.send("/cost", cycles, rr.Scalars.columns(scalars=costs))

    def _draw_members(self, population: Population) -> None:
        values, costs, failures = population
        self.stream.log("/members/all", layout.members(self._space, values, costs))
        bars = costs if failures is None else failures
        self.stream.log("/trials", rr.BarChart(bars, color=layout.MEDIAN))

    def _draw_best(self, search: Search) -> None:
        best = layout.position(self._space, search.best_values, layout.BEST, 1.8)
        self.stream.log("/members/best", best)
        if self._tunes_memberships:
            self._draw_sets(self._best(search).k)

    def _draw_sets(self, k: Memberships) -> None:
        self.stream.log("/surface/gain", layout.gain_surface(k))
        self.stream.log("/sets/best", layout.fuzzy_set_lines(k, base=False))
        self.stream.log("/sets/names", layout.fuzzy_set_names(k))

    def _best(self, search: Search) -> Profile:
        return profile_with(self._space, self._plan.task.base, search.best_values)

    def _tell(self, search: Search, scores: Sequence[tuple[str, str]] = ()) -> None:
        text = _table(self._plan.options.algorithm, [*_progress(self._plan, search), *scores])
        self.stream.log("/progress", rr.TextDocument(text, media_type="text/markdown"))


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
