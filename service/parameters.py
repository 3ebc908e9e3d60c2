"""Requests to replace a profile: asked on other threads, answered by the loop's."""

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import Any, NamedTuple

from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.profile import Profile

# Replacements are rare and made by hand; more waiting requests than this are refused.
MAX_PENDING = 16
ANSWER_TIMEOUT_S = 2.0

# The last is why, if it was retuned and nobody has asked for it
Replace = Callable[[VehicleId, dict[str, Any], str | None], Profile]


class Request(NamedTuple):
    """A change that somebody waits for."""

    vehicle: VehicleId
    partial: dict[str, Any]
    retuned: str | None
    answer: "Future[Profile]"


class ParameterRequests:
    """A mailbox between the threads that ask and the loop that owns the estimators."""

    def __init__(self) -> None:
        self._queue: Queue[Request] = Queue(MAX_PENDING)
        self._closed = False

    def ask(
        self, vehicle: VehicleId, partial: dict[str, Any], retuned: str | None = None
    ) -> Profile:
        """Have the loop replace a profile; blocks until it did. ``retuned`` says why, if by itself.

        Raises:
            InputError: the loop refused it.
            TimeoutError: the loop is too busy, or not running any more.
        """
        if self._closed:
            raise TimeoutError("the service is ending")
        answer: Future[Profile] = Future()
        try:
            self._queue.put_nowait(Request(vehicle, partial, retuned, answer))
        except Full:
            raise TimeoutError("too many requests") from None
        try:
            return answer.result(ANSWER_TIMEOUT_S)
        except TimeoutError:
            if not answer.cancel():  # the loop is at work on it, and will soon be done
                return answer.result()
            raise TimeoutError("the service did not answer in time") from None
        except CancelledError:
            raise TimeoutError("the service is ending") from None

    def waiting(self) -> Iterator[Request]:
        """Take the requests that wait, one after the other."""
        with suppress(Empty):
            while True:
                yield self._queue.get_nowait()

    def serve(self, replace: Replace) -> None:
        """Answer the waiting requests; called by the loop."""
        if self._queue.empty():  # nearly always, and an exception less
            return
        for vehicle, partial, retuned, answer in self.waiting():
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(replace(vehicle, partial, retuned))
            except InputError as error:
                answer.set_exception(error)
            except RecursionError:  # nested deep, but not too deep for the parser
                answer.set_exception(InputError("the profile is nested too deep"))
            except Exception as error:  # noqa: BLE001 - one vehicle's profile ends no service
                why = f"the profile cannot be used: {type(error).__name__}: {error}"
                answer.set_exception(InputError(why))

    def close(self) -> None:
        """Refuse all waiting and all later requests; called when the loop has ended."""
        self._closed = True
        for request in self.waiting():
            request.answer.cancel()
