"""The interface of those who get a link's frames undecoded, such as the service with workers."""

from typing import Protocol

from drivers.mavlink.backlog import Arrived
from drivers.mavlink.stream_request import Outgoing


class FrameTaker(Protocol):
    """Takes the frames that were let in, and recorded. Whoever drains the link calls it."""

    def take(self, arrived: list[Arrived]) -> None:
        """All frames of one look at the link, perhaps none; must not block."""

    def outgoing(self) -> list[Outgoing]:
        """The messages for vehicles that have come together since the last call."""
