"""All attitudes of a period in one Zenoh message, for those who follow many vehicles.

A subscriber that takes them together has one message a period to receive, and not one a vehicle.
"""

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec

from service.records import AttitudeRecord, Output, Published, vehicle_name

if TYPE_CHECKING:
    import zenoh

JSON = "application/json"


class TogetherSink:
    """Publishes the newest attitude of each vehicle on ``{prefix}/attitudes``, once a period.

    The session is somebody else's.
    """

    name = "together"
    never_waits = True  # what a subscriber does not take is dropped

    def __init__(
        self,
        session: "zenoh.Session",
        prefix: str,
        period_s: float,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        import zenoh

        self._publisher = session.declare_publisher(
            f"{prefix}/attitudes",
            encoding=JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,
        )
        self._period_s = period_s
        self._monotonic_s = monotonic_s
        self._due_s = 0.0
        self._newest: dict[str, AttitudeRecord] = {}
        self._encode = msgspec.json.Encoder().encode

    def handle(self, outputs: Sequence[Output]) -> None:
        """Keep the attitudes among the outputs, and publish them when a period has passed."""
        for output in outputs:
            if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                self._newest[vehicle_name(output.vehicle)] = output.record
        now_s = self._monotonic_s()
        if self._newest and now_s >= self._due_s:
            self._due_s = max(self._due_s + self._period_s, now_s)
            self._publisher.put(self._encode(self._newest))
            self._newest.clear()

    def close(self) -> None:
        """Withdraw the key; the session is closed by who has opened it."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]
