"""``run --retune``: segments to a thread with a budget, its decisions to the mailbox."""

import threading
import time
from contextlib import suppress
from queue import Full, Queue

from drivers.closing import Closing
from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile
from fuzzbee.say import say
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from tuning.online.retuned_estimator import RetunedEstimator
from tuning.online.segment import Segment

# Segments that wait for the thread; one that comes when it is full is left out.
MOST_WAITING = 8
# Of a core, in the mean since the beginning; loading and the first searches come on top.
MOST_SHARE = 0.03
ALLOWANCE_S = 10.0
ENDING_S = 2.0

Question = tuple[VehicleId, RetunedEstimator, Segment]


class Retuning(Closing):
    """One retuner a vehicle, all in one thread beside the loop.

    The loop hands over a segment in microseconds and never waits.
    """

    def __init__(self, requests: ParameterRequests, gain: float | None) -> None:
        self._requests = requests
        self._gain = gain
        self._pipeline: Pipeline | None = None
        self._questions: Queue[Question | None] = Queue(MOST_WAITING)
        self._skipped: set[VehicleId] = set()
        self._is_closing = False
        self._begun_s = time.monotonic()
        self._thread = threading.Thread(target=self._work, name="retune", daemon=True)
        self._thread.start()

    def estimator(self, profile: Profile) -> Estimator:
        """An estimator whose segments are handed over."""
        made = RetunedEstimator(
            profile, self._gain, on_segment=lambda segment: self._send(made, segment)
        )
        return made

    def watch(self, pipeline: Pipeline) -> None:
        """The pipeline whose vehicles have those estimators."""
        self._pipeline = pipeline

    def close(self) -> None:
        """End the thread, after the search at hand."""
        self._is_closing = True
        with suppress(Full):  # then it looks at the flag
            self._questions.put_nowait(None)
        self._thread.join(ENDING_S)

    def _send(self, estimator: RetunedEstimator, segment: Segment) -> None:
        """Hand a segment over; called by the loop."""
        vehicles = () if self._pipeline is None else self._pipeline.vehicles
        address = next((v.address for v in vehicles if v.estimator is estimator), None)
        if address is None:
            return
        silent = segment.silent or address in self._skipped
        try:
            self._questions.put_nowait((address, estimator, segment._replace(silent=silent)))
            self._skipped.discard(address)
        except Full:
            self._skipped.add(address)

    def _work(self) -> None:
        while not self._is_closing and (question := self._questions.get()) is not None:
            try:
                self._decide(*question)
            except (InputError, TimeoutError) as error:
                say(f"not retuned: {error}")

    def _decide(self, vehicle: VehicleId, estimator: RetunedEstimator, segment: Segment) -> None:
        """Take a segment. While there is no time for more it counts as silence."""
        budget_s = ALLOWANCE_S + MOST_SHARE * (time.monotonic() - self._begun_s)
        is_late = time.thread_time() > budget_s
        decision = estimator.retuner.take(segment._replace(silent=segment.silent or is_late))
        if decision is not None:
            self._requests.ask(vehicle, decision.update, decision.summary)
