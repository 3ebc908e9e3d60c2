"""Requests for other parameters, on their way to the worker that has the vehicle."""

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.profile import Profile
from service.parameters import ANSWER_TIMEOUT_S, MAX_PENDING, ParameterRequests
from service.workers.job import ProfileAnswer, ProfileRequest


class ProfileRequests(ParameterRequests):
    """Asks a worker; ``send`` takes the vehicle and the message, False if it has no worker."""

    def __init__(self, send: Callable[[VehicleId, bytes], bool]) -> None:
        super().__init__()
        self._send = send
        self._lock = threading.Lock()
        self._last = 0
        self._asked: dict[int, Future[ProfileAnswer]] = {}

    def ask(
        self, vehicle: VehicleId, partial: dict[str, Any], retuned: str | None = None
    ) -> Profile:
        """See :class:`~service.parameters.ParameterRequests`."""
        assert retuned is None, "workers do not retune"
        future: Future[ProfileAnswer] = Future()
        with self._lock:
            if len(self._asked) >= MAX_PENDING:
                raise TimeoutError("too many requests")
            self._last += 1
            number = self._last
            self._asked[number] = future
        try:
            if not self._send(vehicle, pickle.dumps(ProfileRequest(number, vehicle, partial))):
                raise InputError(f"no vehicle {vehicle.system_id}-{vehicle.component_id}")
            return _profile(future.result(ANSWER_TIMEOUT_S))
        except TimeoutError:
            raise TimeoutError("the service did not answer in time") from None
        finally:
            with self._lock:
                del self._asked[number]

    def take(self, answer: ProfileAnswer) -> None:
        """An answer has come."""
        with self._lock:
            future = self._asked.get(answer.number)
        if future is not None:
            future.set_result(answer)


def _profile(answer: ProfileAnswer) -> Profile:
    if answer.profile is not None:
        return answer.profile
    if answer.refusal:
        raise InputError(answer.refusal)
    raise TimeoutError("the service is ending")
