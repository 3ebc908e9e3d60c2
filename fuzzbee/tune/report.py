"""What a search was worth: by what it never saw, as JSON, in words and as a figure."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from estimator.errors import InputError
from estimator.filter.memberships import fuzzy_sets
from estimator.geometry.metrics import COST_RATE_HZ, batch_angle_errors
from estimator.profile import Profile
from fuzzbee.replays.figure import add_legend, draw_sets, written_figure
from fuzzbee.tune.plan import Plan
from tuning.flight import Flight, fly
from tuning.flight_cost import harm, measure
from tuning.paper_experiment import run_experiment
from tuning.search import Search, checkpoint_path
from tuning.space import values_of

LEAST_GAIN = 0.01  # share by which the held-out cost has to fall: less is chance
COMPARED_WITH = {
    "calibration_alone": "the calibration alone",
    "random_search": "random search, same budget",
}
NAME = "tuning.png"
# Fixed gains to compare with, as in the paper: the steadiest, the quickest, and one between.
FIXED_GAINS = (1.0, 10.0, 100.0)
WIDTH_IN, HEIGHT_IN = 10.0, 2.8  # of a panel
MOST_FLIGHTS = 6


def has_gained(before: float, after: float, harmed: str | None) -> bool:
    """Whether the cost of what the search did not see falls, and nothing else gets worse there."""
    return after < (1.0 - LEAST_GAIN) * before and harmed is None


def report_of(
    plan: Plan, search: Search, found: Profile, by_chance: Profile | None
) -> dict[str, Any]:
    """The JSON, but for what concerns the run.

    ``by_chance`` is what random search has found on the same budget, on logs.
    """
    task = plan.task
    before, after = task.score(plan.before), task.score(found)
    report: dict[str, Any] = {
        "evaluations": search.evaluations,
        "cycles": search.cycles,
        "food_sources": plan.options.food_sources,
        "algorithm": plan.options.algorithm,
        "parameters": [*task.groups],
        "reference": plan.reference,
        "inputs": plan.provenance.inputs,
        "cost_before": before["cost"],
        "cost_after": after["cost"],
        "held_out_before": before["held_out"],
        "held_out_after": after["held_out"],
    }
    if plan.request.is_simulated:
        return report
    then, now = ([measure(p, flight) for flight in task.held_out] for p in (plan.before, found))
    report["objective"] = task.goal
    report["random_search"] = None if by_chance is None else task.score(by_chance)
    report["held_out_flights"] = [
        {"name": flight.name, "before": was.as_json(), "after": now_is.as_json()}
        for flight, was, now_is in zip(task.held_out, then, now, strict=True)
    ]
    report["harm"] = harm(then, now) if task.goal == "flight" else None
    if task.base is not plan.before:
        report["calibration_alone"] = task.score(task.base)
    return report


def in_words(plan: Plan, search: Search, report: dict[str, Any]) -> str:
    """The report for a person, of the few numbers of a log's search with their values."""
    unit, space = plan.task.measured.unit, plan.task.space
    lines = [
        f"measured against the {report['reference']}",
        f"tuned on:  J {report['cost_before']:.4f} -> {report['cost_after']:.4f}{unit}",
        f"held out:  J {report['held_out_before']:.4f} -> {report['held_out_after']:.4f}{unit}",
    ]
    for name, words in COMPARED_WITH.items():
        if (other := report.get(name)) is not None:
            lines.append(f"{words}: J {other['cost']:.4f}, held out {other['held_out']:.4f}")
    flights = report.get("held_out_flights", [])
    lines += [f"  {each['name']}: {_change(each['before'], each['after'])}" for each in flights]
    if not (plan.task.tunes_memberships or report["interrupted"]):
        both = zip(space, values_of(space, plan.task.base), search.best_values, strict=True)
        lines += [f"  {parameter.name} {old:.3g} -> {new:.3g}" for parameter, old, new in both]
    file = report["file"] or "not written"
    lines.append(f"{report['evaluations']} evaluations in {report['wall_s']:.1f} s: {file}")
    return "\n".join(lines)


def _change(before: dict[str, Any], after: dict[str, Any]) -> str:
    """RMS before and after, with the share of errors under sigma."""

    def words(figure: dict[str, Any]) -> str:
        share = figure["coverage"]
        under = "" if share is None else f" ({share:.2f} under sigma)"
        return f"{figure['rms_deg']:.2f} deg{under}"

    both = {name: (was, after[name]) for name, was in before.items() if was and after[name]}
    return ", ".join(f"{name} {words(was)} -> {words(now)}" for name, (was, now) in both.items())


def remarks(output: Path, report: dict[str, Any], *, on_logs: bool) -> Iterator[str]:
    """What a person has to know beside the figures."""
    if report["interrupted"]:
        yield f"interrupted: --resume goes on from {checkpoint_path(output)}"
    before, after, harmed = report["held_out_before"], report["held_out_after"], report.get("harm")
    if not on_logs or has_gained(before, after, harmed):
        if after > before:
            yield (
                f"the held-out cost rises from {before:.4f} to {after:.4f}: the result fits what "
                "it was tuned on only; use more data, or keep the base"
            )
        return
    if harmed is None:
        why = f"nothing gained on what was held out (J {before:.4f} -> {after:.4f}, "
        why += f"{100.0 * LEAST_GAIN:g} % less is needed)"
    else:
        change, joint = ("falls", "but") if after < before else ("rises", "and")
        why = f"the held-out J {change} from {before:.4f} to {after:.4f}, {joint} {harmed}"
    what = "is written all the same" if report["file"] else "is not written; --force writes it"
    yield f"{why}: {output} {what}"


# --- the figure: ``tune --plot DIR``


def draw(folder: Path, plan: Plan, tuned: Profile, search: Search) -> None:
    """Draw into ``folder`` how the search went, and what its result changes where it never was."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--plot {folder}: {error.strerror}") from None
    task, is_simulated = plan.task, plan.request.is_simulated
    flights = () if is_simulated else task.held_out[:MOST_FLIGHTS]
    panels = 1 + is_simulated + len(flights) + 2 * task.tunes_memberships
    with written_figure(folder / NAME, "", (WIDTH_IN, HEIGHT_IN * panels)) as sheet:
        first, *axes = sheet.subplots(panels, squeeze=False)[:, 0]
        evaluations, history = [p.evaluations for p in search.history], search.history
        first.plot(evaluations, [p.mean_cost for p in history], label="mean of the population")
        first.plot(evaluations, [p.best_cost for p in history], label="best so far")
        first.set(xlabel="evaluations", ylabel="cost J", title="Convergence of the search")
        add_legend(first, 2)
        if is_simulated:
            _draw_error_over_time(axes[0], task.held_out[0], plan.before, tuned)
        for ax, flight in zip(axes, flights, strict=False):
            _draw_error_on_log(ax, flight, plan.before, tuned)
        if task.tunes_memberships:
            before, after = fuzzy_sets(plan.before.k), fuzzy_sets(tuned.k)
            draw_sets(axes[-2], "e, |de/dt| in 1/s", after.inputs, before.inputs)
            draw_sets(axes[-1], "k_op", after.output, before.output)
            for ax in axes[-2:]:
                ax.set_title("Fuzzy sets, dotted: before")


def _draw_error_over_time(axes: Any, seed: int, before: Profile, tuned: Profile) -> None:
    """e(R~) on a noise seed that the search has not seen, against fixed gains."""
    runs = {f"K = {gain:g}": run_experiment(tuned, seed, gain) for gain in FIXED_GAINS}
    runs |= {"fuzzy, before": run_experiment(before, seed)}
    runs |= {"fuzzy, tuned": run_experiment(tuned, seed)}
    for name, run in runs.items():
        time_s = np.arange(1, len(run.true_error) + 1) / COST_RATE_HZ
        axes.plot(time_s, run.true_error, label=name, linewidth=2.0 if "tuned" in name else 0.8)
    axes.set(xlabel="time in s, from 0.01 s on", ylabel="e(R~)", xscale="log", yscale="log")
    axes.set(ylim=(1e-5, 1.5), title=f"Normalised Euclidean distance (noise seed {seed})")
    add_legend(axes, len(runs))


def _draw_error_on_log(axes: Any, flight: Flight, before: Profile, tuned: Profile) -> None:
    """Inclination error over time on a held-out flight, before and after."""
    known = flight.known[flight.window]
    for name, profile in (("before", before), ("tuned", tuned)):
        course = fly(flight, profile)
        errors = batch_angle_errors(course.q_ned_frd[flight.window], flight.truth[flight.window])
        time_s = flight.time_s[flight.window][known]
        axes.plot(time_s, np.degrees(errors[known, 2]), linewidth=0.9, label=name)
    axes.set(title=flight.name, ylabel="inclination error in deg", xlabel="time in s")
    add_legend(axes, 2)
