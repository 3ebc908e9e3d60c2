"""Retuning beside a live service: a process of low priority that is sent segments and decides."""

import os
import time
from typing import NamedTuple

from tuning import child
from tuning.online.retuner import Decision, Retuner
from tuning.online.segment import Segment

NICENESS = 15
# Of a core, in the mean since the beginning; loading and the first searches come on top.
MOST_SHARE = 0.03
ALLOWANCE_S = 10.0
MOST_VEHICLES = 512  # then the one whose last segment is oldest is forgotten


class Question(NamedTuple):
    """A vehicle's next segment; ``vehicle`` is anything that tells vehicles apart."""

    vehicle: object
    segment: Segment


class Answer(NamedTuple):
    """What follows for that vehicle."""

    vehicle: object
    decision: Decision


class Deciders:
    """A retuner a vehicle, within a share of one core's time."""

    def __init__(self) -> None:
        self._retuners: dict[object, Retuner] = {}
        self._begun_s = time.monotonic()
        self._used_s = time.process_time()

    def answer(self, question: Question) -> Answer | None:
        """Take a segment. While there is no time for more it counts as silence."""
        segment = question.segment
        retuner = self._retuners.pop(question.vehicle, None) or Retuner(segment.profile)
        self._retuners[question.vehicle] = retuner  # the latest last
        if len(self._retuners) > MOST_VEHICLES:
            del self._retuners[next(iter(self._retuners))]
        decision = retuner.take(segment._replace(silent=segment.silent or self._is_late()))
        return None if decision is None else Answer(question.vehicle, decision)

    def _is_late(self) -> bool:
        elapsed_s = time.monotonic() - self._begun_s
        used_s = time.process_time() - self._used_s
        return used_s > ALLOWANCE_S + MOST_SHARE * elapsed_s


def serve() -> None:
    """Answer questions until there are no more."""
    os.nice(NICENESS)
    questions, answer = child.channel()
    deciders = Deciders()
    for question in questions:
        found = deciders.answer(question)
        if found is not None:
            answer(found)
