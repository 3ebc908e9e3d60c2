"""Smoothed references that the numbers under search have not made themselves: cross-fitting.

What is searched on is halved. What a search finds on one half smooths the other, so that the
reference of no part was made by numbers that were chosen on it (V. Chernozhukov and others, 2018,
doi:10.1111/ectj.12097). What is held out keeps the base profile's, on which nothing was chosen.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from estimator.profile import Profile
from tuning.flight import Part
from tuning.log_task import LogTask
from tuning.smoothed import sure_flight

Parts = tuple[Part, ...]


def cross(task: LogTask, search: Callable[[LogTask], Profile]) -> LogTask:
    """The task with crossed references, by what ``search`` finds on each half of it.

    It stays as it is without a smoothed reference, and where the paper's J needs none so good.
    """
    parts = task.split.tuning
    if task.goal == "recovery" or all(part.flight.reference != "smooth" for part in parts):
        return task
    one, other = halves(parts)
    by_one, by_other = (
        search(replace(task, split=task.split._replace(tuning=half))) for half in (one, other)
    )
    crossed = (*smoothed_by(by_other, one), *smoothed_by(by_one, other))
    return replace(task, split=task.split._replace(tuning=crossed))


def halves(parts: Parts) -> tuple[Parts, Parts]:
    """Every other flight; of one the earlier and the later half of what its reference knows."""
    if len(parts) > 1:
        return parts[::2], parts[1::2]
    (part,) = parts
    known = part.first + np.flatnonzero(part.flight.known[part.window])
    middle = int(known[len(known) // 2])
    return (part._replace(last=middle),), (part._replace(first=middle),)


def smoothed_by(profile: Profile, parts: Parts) -> Parts:
    """The parts with references by ``profile``, where they were smoothed and these are sure too."""
    return tuple(_smoothed_by(profile, part) for part in parts)


def _smoothed_by(profile: Profile, part: Part) -> Part:
    if part.flight.reference != "smooth":
        return part
    flight = sure_flight(part.flight, profile, is_wanted=False)
    return part._replace(flight=flight) if flight.known[part.window].any() else part
