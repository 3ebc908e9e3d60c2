"""What a person is told about links that come and go."""

from drivers.events import LinkDown, LinkUp


class LinkLines:
    """A line for each change of a link; remembers which ones are up."""

    def __init__(self) -> None:
        self._up: set[str] = set()

    def line(self, event: LinkUp | LinkDown) -> str:
        """The line for one change."""
        endpoint = event.endpoint
        if isinstance(event, LinkUp):
            self._up.add(endpoint)
            return _link_text(endpoint)
        if endpoint not in self._up:
            return f"{endpoint}: {event.reason}; trying again"
        self._up.discard(endpoint)
        return f"{endpoint} lost: {event.reason}; trying again"


def _link_text(endpoint: str) -> str:
    """What is known of a link that works: of UDP and a device only that our end of it is open."""
    kind, _, _ = endpoint.partition(":")
    match kind:
        case "udpin":
            return f"listening on {endpoint}"
        case "udpout":
            return f"sending to {endpoint}"
        case "sim":
            return f"{endpoint} started"
        case "tcp" | "tcpin":
            return f"{endpoint} connected"
    return f"{endpoint} open"
