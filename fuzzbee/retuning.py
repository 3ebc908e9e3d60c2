"""``run --retune``: segments to a process of low priority, its decisions to the mailbox."""

import pickle
import threading
from collections.abc import Callable
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
from tuning import child
from tuning.online import worker
from tuning.online.retuned_estimator import SegmentingEstimator
from tuning.online.segment import Segment
from tuning.online.worker import Answer, Question

# Segments that wait for the process; one that comes when it is full is left out.
MOST_WAITING = 8
ENDING_S = 2.0


class Retuning(Closing):
    """A process beside the service, and the two threads that speak with it.

    The loop hands over a segment in microseconds and never waits. If the process dies,
    the service goes on with the profiles in force.
    """

    def __init__(self, requests: ParameterRequests, gain: float | None) -> None:
        self._requests = requests
        self._gain = gain
        self._pipeline: Pipeline | None = None
        self._questions: Queue[Question | None] = Queue(MOST_WAITING)
        self._skipped: set[VehicleId] = set()
        self._is_closing = False
        self._process = child.start(worker.__name__)
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=f"retune {name}", daemon=True)
            for name, work in (("questions", self._ask), ("answers", self._listen))
        ]
        for thread in self._threads:
            thread.start()

    def estimator(self, profile: Profile) -> Estimator:
        """An estimator whose segments are sent."""
        made = SegmentingEstimator(profile, self._gain)
        made.on_segment = lambda segment: self._send(made, segment)
        return made

    def watch(self, pipeline: Pipeline) -> None:
        """The pipeline whose vehicles have those estimators."""
        self._pipeline = pipeline

    def close(self) -> None:
        """End the process."""
        self._is_closing = True
        self._process.kill()
        self._process.wait()
        with suppress(Full):  # then the thread is at a pipe that has just broken
            self._questions.put_nowait(None)
        for thread in self._threads:
            thread.join(ENDING_S)
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                assert pipe is not None
                pipe.close()

    def _send(self, estimator: Estimator, segment: Segment) -> None:
        """Called by the loop."""
        vehicles = () if self._pipeline is None else self._pipeline.vehicles
        address = next((v.address for v in vehicles if v.estimator is estimator), None)
        if address is None:
            return
        silent = segment.silent or address in self._skipped
        try:
            self._questions.put_nowait(Question(address, segment._replace(silent=silent)))
            self._skipped.discard(address)
        except Full:
            self._skipped.add(address)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except (OSError, EOFError, ValueError, pickle.PickleError) as error:
            if not self._is_closing:
                say(f"--retune has ended: {type(error).__name__}; the profiles in force stay")

    def _ask(self) -> None:
        while (question := self._questions.get()) is not None:
            child.send(self._process, question)

    def _listen(self) -> None:
        while True:
            answer: Answer = child.receive(self._process)
            assert isinstance(answer.vehicle, VehicleId)
            decision = answer.decision
            try:
                self._requests.ask(answer.vehicle, decision.update, decision.summary)
            except (InputError, TimeoutError) as error:
                say(f"not retuned: {error}")
