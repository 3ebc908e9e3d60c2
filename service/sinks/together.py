"""All vehicles' attitudes in one put, for who wants all of them: one JSON object by vehicle.

A put costs more than an attitude. A fleet's subscriber that takes them together has one message a
tick to receive, and not one a vehicle.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from service.attitude_rows import AttitudeRows, Made, encoded
from service.records import Encoded, vehicle_name

if TYPE_CHECKING:
    import zenoh

JSON = "application/json"


class TogetherSink:
    """Publishes on ``{prefix}/attitudes``, on a session of somebody else's."""

    name = "together"
    never_waits = True  # what a subscriber does not take is dropped
    takes_rows = True

    def __init__(self, session: "zenoh.Session", prefix: str) -> None:
        import zenoh

        self._publisher = session.declare_publisher(
            f"{prefix}/attitudes",
            encoding=JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,
        )
        self._encode = msgspec.json.Encoder().encode

    def handle(self, outputs: Sequence[Made]) -> None:
        """Publish the attitudes among the outputs; the last one of each vehicle."""
        attitudes: dict[str, msgspec.Raw] = {}
        for output in encoded(outputs):
            if isinstance(output, AttitudeRows):
                texts = map(msgspec.Raw, output.texts)
                attitudes |= zip(map(vehicle_name, output.vehicles), texts, strict=True)
            elif isinstance(output, Encoded):
                attitudes[vehicle_name(output.vehicle)] = msgspec.Raw(output.payload)
        if attitudes:
            self._publisher.put(self._encode(attitudes))

    def close(self) -> None:
        """Withdraw the key; the session is closed by who has opened it."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]
