"""What a run came to: the result that ``--json`` prints, a line for a person, the exit status."""

import json
from collections.abc import Iterable
from typing import Any

from drivers.simulation.simulated_vehicle import PROFILES
from fuzzbee.notify import notify
from fuzzbee.run import RunOptions
from fuzzbee.truth_score import ScoredPipeline, TruthScore
from service.runner import Runner
from service.vehicle_status import counts

OK, FAILED = 0, 1
NOT_WHOLE = "failed"  # of a recording


def recording_word(things: Iterable[Any]) -> str:
    """Whether the files that some of the things keep are whole so far; empty where none does."""
    are_whole = [each.is_whole for each in things if hasattr(each, "is_whole")]
    return "" if not are_whole else "whole" if all(are_whole) else NOT_WHOLE


def summary(
    options: RunOptions, profile_name: str, seconds: float, runner: Runner, pipeline: ScoredPipeline
) -> dict[str, Any]:
    """The result of a run, as --json prints it."""
    recording, vehicles = runner.recording(), pipeline.vehicles
    # of fuzzbee's own vehicles the one that fits their motion, unless another was asked for
    fitting = {PROFILES.get(each.built_in_motion or "") or profile_name for each in vehicles}
    only = fitting.pop() if options.profile is None and len(fitting) == 1 else profile_name
    result = {
        "source": options.source,
        "profile": only,
        "rate_hz": options.rate_hz,
        "seconds": round(seconds, 3),
        "ticks": runner.ticks,
        "overruns": runner.overruns,
        "dropped": runner.dropped,
        "lost": runner.source.lost,
        "malformed": pipeline.malformed,
        "refused": dict(sorted(pipeline.refused_frames.items())),
        **({"recording": recording} if recording else {}),
        "heard": sorted(pipeline.systems),
        "departed": dict(pipeline.evicted),
        "vehicles": {vehicle.name: counts(vehicle) for vehicle in vehicles},
    }
    if pipeline.scores is not None:
        result["truth"] = {name: score.result() for name, score in pipeline.scores.items()}
    return result


def conclude(
    options: RunOptions,
    result: dict[str, Any],
    runner: Runner,
    scores: dict[str, TruthScore] | None,
    problems: list[Exception],
) -> int:
    """Report the result and raise what went wrong first.

    The status is 1 if nobody was heard until the end, or a recording is not whole, else 0.
    A vehicle that was refused has been heard, too.
    """
    if runner.outbox.stuck:
        notify(f"not closed in time: {', '.join(runner.outbox.stuck)}")
        if "recording" in result:  # nobody knows what it lacks
            result["recording"] = NOT_WHOLE
    for error in runner.outbox.unreported:
        notify(error)
    if options.as_json:
        print(json.dumps(result), flush=True)
    else:
        _notify_result(result, scores or {})
    if problems:
        raise problems[0]
    received = result["vehicles"] or result["departed"]["vehicles"] or result["refused"]
    is_whole = result.get("recording") != NOT_WHOLE
    return OK if is_whole and (received or runner.was_stopped) else FAILED


def _notify_result(result: dict[str, Any], scores: dict[str, TruthScore]) -> None:
    for name, score in scores.items():
        if verdict := score.verdict():
            notify(f"vehicle {name} {verdict}")
    departed, lasted = result["departed"], f"in {result['seconds']:.1f} s"
    number = len(result["vehicles"]) + departed["vehicles"]
    if not number:
        others = ", ".join(map(str, result["heard"]))
        which = f" but system id {others}" if others else ""
        notify(f"no vehicle{which} was heard on {result['source']} {lasted}")
        return
    attitudes = departed["attitudes"] + sum(v["attitudes"] for v in result["vehicles"].values())
    of_whom = f"{number} vehicle{'s' * (number != 1)}"
    notify(f"{attitudes} attitudes of {of_whom} {lasted}, {result['overruns']} overruns")
