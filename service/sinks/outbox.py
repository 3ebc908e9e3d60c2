"""All sinks at once: each output goes to each of them."""

import time
from collections.abc import Sequence
from typing import Self

from service.records import Message, Output
from service.sinks.sink import Outlet, Sink

CLOSE_TIMEOUT_S = 0.7  # for all sinks together: the command ends within a second


class Outbox:
    """The sinks of a run, each behind its own outlet. A context manager that closes them."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._outlets = tuple(Outlet(sink) for sink in sinks)
        self._waited_for = [outlet for outlet in self._outlets if outlet.never_waits]
        self.stuck: list[str] = []
        self.untold: list[str] = []  # errors that came last

    @property
    def dropped(self) -> int:
        """Records that lagging sinks lost."""
        return sum(outlet.dropped for outlet in self._outlets)

    @property
    def errors(self) -> int:
        """How often sinks failed."""
        return sum(outlet.errors for outlet in self._outlets)

    def put(self, outputs: Sequence[Output]) -> None:
        """Hand outputs to every sink, and one sink's errors to all; never blocks."""
        for outlet in self._outlets:
            if outlet.error is not None:
                outputs = [*outputs, Message(outlet.take_error())]
        if outputs:
            for outlet in self._outlets:
                outlet.put(outputs)

    def settle(self, timeout_s: float) -> bool:
        """Wait until the sinks that wait for nobody have taken everything; whether they have.

        Meanwhile the caller would only keep Python's lock from them, half a millisecond a record.
        """
        end_s = time.monotonic() + timeout_s
        for outlet in self._waited_for:
            if outlet.is_busy and not outlet.settle(end_s - time.monotonic()):
                return False
        return True

    def close(self) -> None:
        """Deliver what is pending and close every sink; ``stuck`` names those that hang."""
        end_s = time.monotonic() + CLOSE_TIMEOUT_S
        for outlet in self._outlets:
            outlet.begin_close()
        for outlet in self._outlets:
            if not outlet.join(max(0.01, end_s - time.monotonic())):
                self.stuck.append(outlet.sink.name)
        self.untold += [each.take_error() for each in self._outlets if each.error is not None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
