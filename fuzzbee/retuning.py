"""``run --retune``: segments to a thread with a budget, its decisions to the mailbox."""

import threading
import time
from contextlib import suppress
from queue import Full, Queue

from drivers.events import VehicleId
from drivers.resources import Closing
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile
from fuzzbee.notify import notify
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from tuning.online.retuner import RetunedEstimator
from tuning.online.segment import Segment

MOST_WAITING = 8  # segments; one that comes when the queue is full is left out
# Of a core, in the mean since the beginning; loading and the first searches come on top.
MOST_SHARE, ALLOWANCE_S = 0.03, 10.0
ENDING_S = 2.0


class Retuning(Closing):
    """One retuner a vehicle, all in one thread beside the loop.

    The loop hands over a segment in microseconds and never waits. What is left out, for want of
    room or of time, is a silence for the retuner.
    """

    def __init__(self, requests: ParameterRequests, gain: float | None) -> None:
        self._requests = requests
        self._gain = gain
        self.pipeline: Pipeline | None = None  # whose vehicles have estimators of ours
        self._segments = Queue[tuple[VehicleId, RetunedEstimator, Segment] | None](MOST_WAITING)
        self._is_closing = False
        self._begun_s = time.monotonic()
        self._thread = threading.Thread(target=self._work, name="retune", daemon=True)
        self._thread.start()

    def estimator(self, profile: Profile) -> Estimator:
        """An estimator whose segments are handed over."""
        made = RetunedEstimator(profile, self._gain, lambda segment: self._send(made, segment))
        return made

    def close(self) -> None:
        """End the thread, after the search at hand."""
        self._is_closing = True
        with suppress(Full):  # then it looks at the flag
            self._segments.put_nowait(None)
        self._thread.join(ENDING_S)

    def _send(self, estimator: RetunedEstimator, segment: Segment) -> None:
        """Hand a segment over; called by the loop."""
        for vehicle in () if self.pipeline is None else self.pipeline.vehicles:
            if vehicle.estimator is estimator:
                with suppress(Full):
                    self._segments.put_nowait((vehicle.address, estimator, segment))

    def _work(self) -> None:
        while not self._is_closing and (waiting := self._segments.get()) is not None:
            vehicle, estimator, segment = waiting
            share_s = MOST_SHARE * (time.monotonic() - self._begun_s)
            if time.thread_time() > ALLOWANCE_S + share_s:
                continue
            try:
                decision = estimator.retuner.take(segment)
                if decision is not None:
                    self._requests.ask(vehicle, decision.update, decision.summary)
            except (InputError, TimeoutError) as error:
                notify(f"not retuned: {error}")
