"""Runs a planned search: threads or cluster, progress, signals, checkpoint, result."""

import contextlib
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from estimator.profile import Profile, Provenance, profile_to_toml
from fuzzbee.say import tell
from fuzzbee.tune.plan import Plan
from fuzzbee.tune.request import TuneRequest
from fuzzbee.tune.searches import Searches, Watch, best
from service.signals import stop_on_signals
from tuning.checkpoint import checkpoint_path, read_checkpoint, write_atomically
from tuning.crossing import cross
from tuning.flight_cost import FlightFigures, harm
from tuning.log_task import GOALS, LogTask
from tuning.objective import Scores, values_of
from tuning.search import InterruptedSearch, Search

if TYPE_CHECKING:
    from fuzzbee.tune.view import SearchView
    from fuzzbee.viewer.stream import ViewerOptions

NAMES = {
    "abc": "artificial bee colony",
    "cmaes": "CMA-ES",
    "de": "differential evolution",
    "random": "random search",
}
# A profile gains if the held-out cost falls by this share at least: less is chance.
LEAST_GAIN = 0.01
NO_GAIN = 1
INTERRUPTED = 130


class Outcome(NamedTuple):
    """A search that ran to its end or was interrupted, and the profile it found."""

    search: Search
    finished: bool
    profile: Profile


class Verdict(NamedTuple):
    """The scores of base and result; and, on logs, what chance found with the same budget.

    ``flights`` are the held-out flights' names and figures before and after, ``harm`` is what got
    worse on them, in words.
    """

    before: Scores
    after: Scores
    rival: Scores | None
    flights: tuple[tuple[str, FlightFigures, FlightFigures], ...] = ()
    harm: str | None = None

    @property
    def gains(self) -> bool:
        """Whether the result is better on what the search did not see, and nothing worse."""
        lower = self.after.held_out < (1.0 - LEAST_GAIN) * self.before.held_out
        return lower and self.harm is None


def run_plan(plan: Plan, request: TuneRequest, viewer: "ViewerOptions | None") -> int:
    """Search, write the profile, report; the exit status.

    On logs a profile that gains nothing on what was held out, or harms it, is written with
    ``force`` only.

    Raises:
        InputError: nothing to resume, no cluster, no viewer, or a file that cannot be written.
    """
    started = time.perf_counter()
    checkpoint = checkpoint_path(plan.output)
    earlier = read_checkpoint(checkpoint, plan.identity) if request.resume else []
    if not earlier and checkpoint.exists():
        tell(f"{checkpoint}: an unfinished search, not resumed; it will be replaced")
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        view = _open_view(viewer, plan, stack)
        searches = Searches(plan, request, stop, earlier)
        with stop_on_signals(stop.set):
            plan, outcome, verdict = _run(plan, searches, None if view is None else view.show)
        written = verdict.gains or request.force or not isinstance(plan.task, LogTask)
        _write(plan, outcome, checkpoint, request.plot, written=written)
        report = _report(plan, outcome, verdict, time.perf_counter() - started)
        report["file"] = str(plan.output) if written else None
        if request.as_json:
            print(json.dumps(report), flush=True)
        else:
            _print_report(plan, outcome, report)
        _tell_gain(plan, verdict, written=written)
        if view is not None:
            view.finish(outcome.search)
            if outcome.finished:
                view.stream.stay_open()
    if not outcome.finished:
        return INTERRUPTED
    return 0 if written else NO_GAIN


def _write(
    plan: Plan, outcome: Outcome, checkpoint: Path, figures: Path | None, *, written: bool
) -> None:
    """The profile and figures, if they are wanted; a finished search needs no checkpoint."""
    if written:
        write_atomically(plan.output, profile_to_toml(outcome.profile).encode())
    if outcome.finished:
        checkpoint.unlink(missing_ok=True)
    if figures is not None:
        from fuzzbee.tune.plots import draw

        draw(figures, plan.task, outcome.profile, outcome.search)


def _run(plan: Plan, searches: Searches, watch: Watch | None) -> tuple[Plan, Outcome, Verdict]:
    """Search on references that are crossed first, where they are smoothed ones."""
    try:
        if isinstance(plan.task, LogTask):
            plan = plan._replace(task=cross(plan.task, searches.found))
        with searches.evaluator(plan.task) as evaluate:
            search = searches.run(plan.task, evaluate, watch)
            outcome = Outcome(search, True, _profile(plan, search, finished=True))
            return (
                plan,
                outcome,
                _judge(plan, outcome, lambda: searches.by_chance(plan.task, evaluate)),
            )
    except InterruptedSearch:
        search = searches.latest
        outcome = Outcome(search, False, _profile(plan, search, finished=False))
        return plan, outcome, _judge(plan, outcome, lambda: None)


def _judge(plan: Plan, outcome: Outcome, chance: Callable[[], Profile | None]) -> Verdict:
    """Score base and result, and what chance finds with the same budget."""
    before, after = plan.task.score(plan.task.base), plan.task.score(outcome.profile)
    if not isinstance(plan.task, LogTask):
        return Verdict(before, after, None)
    then, now = (plan.task.held_out_figures(p) for p in (plan.task.base, outcome.profile))
    flights = tuple((name, was, is_) for (name, was), (_, is_) in zip(then, now, strict=True))
    harmed = harm([f for _, f in then], [f for _, f in now]) if plan.task.goal == "flight" else None
    found = chance()
    rival = None if found is None else plan.task.score(found)
    return Verdict(before, after, rival, flights, harmed)


def _tell_gain(plan: Plan, verdict: Verdict, *, written: bool) -> None:
    before, after = verdict.before.held_out, verdict.after.held_out
    if verdict.gains or not isinstance(plan.task, LogTask):
        if after > before:
            tell(
                f"the held-out cost rose from {before:.4f} to {after:.4f}: the result fits what it "
                "was tuned on only; use more data, or keep the base"
            )
        return
    if verdict.harm is None:
        why = f"nothing gained on what was held out ({before:.4f} -> {after:.4f}, "
        why += f"{100.0 * LEAST_GAIN:g} % less is needed)"
    elif after < before:
        why = f"the held-out J falls from {before:.4f} to {after:.4f}, but {verdict.harm}"
    else:
        why = f"what was held out is worse: {verdict.harm}"
    tell(
        f"{why}: "
        + (
            f"{plan.output} is written all the same"
            if written
            else "not written; --force writes it"
        )
    )


def _open_view(
    viewer: "ViewerOptions | None", plan: Plan, stack: contextlib.ExitStack
) -> "SearchView | None":
    if viewer is None:
        return None
    from fuzzbee.outputs import tell_page
    from fuzzbee.tune.view import SearchView

    view = SearchView(viewer, plan)
    stack.callback(view.close)
    tell_page(view.stream)
    return view


def _profile(plan: Plan, search: Search, *, finished: bool) -> Profile:
    """The base profile with the values that were found, and their provenance."""
    groups = plan.identity["options"]["parameters"]
    description = f"{groups} by {NAMES[plan.options.algorithm]} against the {plan.reference}"
    if not finished:
        description += f", interrupted after {search.evaluations} of {plan.options.budget}"
    provenance = Provenance(description=description, **plan.identity)
    return msgspec.structs.replace(best(plan.task, search), provenance=provenance)


def _report(plan: Plan, outcome: Outcome, verdict: Verdict, wall_s: float) -> dict[str, Any]:
    search, before, after, rival = outcome.search, *verdict[:3]
    report = {
        "evaluations": search.evaluations,
        "cycles": search.cycles,
        "food_sources": plan.options.food_sources,
        "algorithm": plan.options.algorithm,
        "parameters": plan.identity["options"]["parameters"].split(","),
        "reference": plan.reference,
        "inputs": plan.inputs,
        "cost_before": before.tuning,
        "cost_after": after.tuning,
        "held_out_before": before.held_out,
        "held_out_after": after.held_out,
        "wall_s": wall_s,
        "interrupted": not outcome.finished,
    }
    if isinstance(plan.task, LogTask):
        report["objective"] = plan.task.goal
        report["random_search"] = (
            None if rival is None else {"cost": rival.tuning, "held_out": rival.held_out}
        )
        report["held_out_flights"] = [
            {"name": name, "before": then.as_json(), "after": now.as_json()}
            for name, then, now in verdict.flights
        ]
        report["harm"] = verdict.harm
    return report


def _print_report(plan: Plan, outcome: Outcome, report: dict[str, Any]) -> None:
    print(f"measured against the {report['reference']}")
    unit = GOALS[plan.task.goal].unit if isinstance(plan.task, LogTask) else ""
    print(f"tuned on:  J {report['cost_before']:.4f} -> {report['cost_after']:.4f}{unit}")
    print(f"held out:  J {report['held_out_before']:.4f} -> {report['held_out_after']:.4f}{unit}")
    rival = report.get("random_search")
    if rival is not None:
        print(
            f"random search, same budget: J {rival['cost']:.4f}, held out {rival['held_out']:.4f}"
        )
    for flight in report.get("held_out_flights", []):
        print(f"  {flight['name']}: {_change(flight['before'], flight['after'])}")
    if outcome.finished:
        for name, value in _changes(plan, outcome):
            print(f"  {name} {value}")
    file = report["file"] or "not written"
    print(f"{report['evaluations']} evaluations in {report['wall_s']:.1f} s: {file}")
    if report["interrupted"]:
        checkpoint = checkpoint_path(plan.output)
        tell(f"interrupted: the best so far is written; --resume goes on from {checkpoint}")


def _change(before: dict[str, Any], after: dict[str, Any]) -> str:
    """RMS before and after, with the share of errors under sigma."""
    return ", ".join(
        f"{name} {_figure(before[name])} -> {_figure(after[name])}"
        for name in before
        if before[name] is not None and after[name] is not None
    )


def _figure(figure: dict[str, Any]) -> str:
    share = figure["coverage"]
    return f"{figure['rms_deg']:.2f} deg" + ("" if share is None else f" ({share:.2f} in sigma)")


def _changes(plan: Plan, outcome: Outcome) -> list[tuple[str, str]]:
    """The few numbers of a log's search, before and after; the 22 memberships are no reading."""
    space = plan.task.space
    if not isinstance(plan.task, LogTask) or "k1" in space.names:
        return []
    old, new = values_of(space, plan.task.base), outcome.search.best_values
    return [(name, f"{x:.3g} -> {y:.3g}") for name, x, y in zip(space.names, old, new, strict=True)]
