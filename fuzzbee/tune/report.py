"""What a search was worth: by what it never saw, as JSON and in words."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from estimator.profile import Profile
from fuzzbee.tune.plan import Plan
from tuning.checkpoint import checkpoint_path
from tuning.flight_cost import FlightFigures, harm
from tuning.log_task import GOALS, LogTask
from tuning.paper_task import PaperTask
from tuning.search import Search
from tuning.task import Scores, values_of

# A profile gains if the held-out cost falls by this share at least: less is chance.
LEAST_GAIN = 0.01
_BY_CHANCE = "random search, same budget"


class Verdict(NamedTuple):
    """The scores of base and result; and, on logs, what chance found with the same budget.

    ``fitted`` are those of the calibration that a search began with, if it did.
    ``flights`` are the held-out flights' names and figures before and after, ``harm`` is what got
    worse on them, in words.
    """

    before: Scores
    after: Scores
    random_search: Scores | None
    flights: tuple[tuple[str, FlightFigures, FlightFigures], ...] = ()
    harm: str | None = None
    fitted: Scores | None = None

    @property
    def gains(self) -> bool:
        """Whether the result is better on what the search did not see, and nothing worse."""
        lower = self.after.held_out < (1.0 - LEAST_GAIN) * self.before.held_out
        return lower and self.harm is None


def judge(task: PaperTask | LogTask, found: Profile, by_chance: Profile | None) -> Verdict:
    """Score base and result, and what chance has found with the same budget."""
    before, after = task.score(task.before), task.score(found)
    if not isinstance(task, LogTask):
        return Verdict(before, after, None)
    then, now = (task.held_out_figures(profile) for profile in (task.before, found))
    flights = tuple((name, was, is_) for (name, was), (_, is_) in zip(then, now, strict=True))
    harmed = harm([f for _, f in then], [f for _, f in now]) if task.goal == "flight" else None
    random_search = None if by_chance is None else task.score(by_chance)
    fitted = None if task.judged_by is None else task.score(task.base)
    return Verdict(before, after, random_search, flights, harmed, fitted)


def report_of(plan: Plan, search: Search, verdict: Verdict) -> dict[str, Any]:
    """The JSON, but for what concerns the run."""
    before, after, random_search = verdict[:3]
    report: dict[str, Any] = {
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
    }
    if isinstance(plan.task, LogTask):
        report["objective"] = plan.task.goal
        report["random_search"] = None if random_search is None else _costs(random_search)
        report["held_out_flights"] = [
            {"name": name, "before": then.as_json(), "after": now.as_json()}
            for name, then, now in verdict.flights
        ]
        report["harm"] = verdict.harm
    if verdict.fitted is not None:
        report["calibration_alone"] = _costs(verdict.fitted)
    return report


def _costs(scores: Scores) -> dict[str, float]:
    return {"cost": scores.tuning, "held_out": scores.held_out}


def in_words(plan: Plan, search: Search, report: dict[str, Any]) -> str:
    """The report for a person, of the few numbers of a log's search with their values."""
    unit = GOALS[plan.task.goal].unit if isinstance(plan.task, LogTask) else ""
    lines = [
        f"measured against the {report['reference']}",
        f"tuned on:  J {report['cost_before']:.4f} -> {report['cost_after']:.4f}{unit}",
        f"held out:  J {report['held_out_before']:.4f} -> {report['held_out_after']:.4f}{unit}",
    ]
    others = {"calibration_alone": "the calibration alone", "random_search": _BY_CHANCE}
    for name, words in others.items():
        if (other := report.get(name)) is not None:
            costs = f"J {other['cost']:.4f}, held out {other['held_out']:.4f}"
            lines.append(f"{words}: {costs}")
    flights = report.get("held_out_flights", [])
    lines += [f"  {each['name']}: {_change(each['before'], each['after'])}" for each in flights]
    space = plan.task.space
    if isinstance(plan.task, LogTask) and "k1" not in space.names and not report["interrupted"]:
        both = zip(values_of(space, plan.task.base), search.best_values, strict=True)
        for name, (old, new) in zip(space.names, both, strict=True):
            lines.append(f"  {name} {old:.3g} -> {new:.3g}")
    file = report["file"] or "not written"
    lines.append(f"{report['evaluations']} evaluations in {report['wall_s']:.1f} s: {file}")
    return "\n".join(lines)


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


def remarks(plan: Plan, verdict: Verdict, report: dict[str, Any]) -> Iterator[str]:
    """What a person has to know beside the figures."""
    if report["interrupted"]:
        yield f"interrupted: --resume goes on from {checkpoint_path(plan.output)}"
    before, after = verdict.before.held_out, verdict.after.held_out
    if verdict.gains or not isinstance(plan.task, LogTask):
        if after > before:
            yield (
                f"the held-out cost rises from {before:.4f} to {after:.4f}: the result fits what "
                "it was tuned on only; use more data, or keep the base"
            )
        return
    if verdict.harm is None:
        why = f"nothing gained on what was held out (J {before:.4f} -> {after:.4f}, "
        why += f"{100.0 * LEAST_GAIN:g} % less is needed)"
    else:
        change, joint = ("falls", "but") if after < before else ("rises", "and")
        why = f"the held-out J {change} from {before:.4f} to {after:.4f}, {joint} {verdict.harm}"
    what = "is written all the same" if report["file"] else "is not written; --force writes it"
    yield f"{why}: {plan.output} {what}"
