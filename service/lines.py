"""Log lines: of links, and a readable number for each vehicle."""

from drivers.events import LinkDown, LinkUp

MOST_LINES = 12  # a minute; one further line reports that the rest is left out
MINUTE_US = 60_000_000
TOO_MANY = f"there were more than {MOST_LINES} within a minute"


class LineLimit:
    """Passes on as many lines a minute as a person can read, and reports how many it left out.

    Time comes in as an argument.
    """

    def __init__(self, who: str) -> None:
        self._who = who
        self._since_us: int | None = None
        self._lines = 0

    def lines(self, texts: list[str], now_us: int) -> list[str]:
        """The lines to print for ``texts`` at ``now_us``."""
        if not texts:
            return []
        if self._since_us is None or not 0 <= now_us - self._since_us < MINUTE_US:
            left_out = max(0, self._lines - MOST_LINES)
            self._since_us, self._lines = now_us, 0
            if left_out:
                texts = [f"{self._who}: {left_out} lines were left out: {TOO_MANY}", *texts]
        before, self._lines = self._lines, self._lines + len(texts)
        kept = texts[: max(0, MOST_LINES - before)]
        if before <= MOST_LINES < self._lines:
            kept = [*kept, f"{self._who}: more lines are left out: {TOO_MANY}"]
        return kept


# What is known of a link that works: of UDP and a device only that our end of it is open.
UP = {
    "udpin": "listening on {}",
    "udpout": "sending to {}",
    "sim": "{} started",
    "tcp": "{} connected",
    "tcpin": "{} connected",
}


def link_line(event: LinkUp | LinkDown, up: set[str]) -> str:
    """The line for one change of a link; ``up`` are those that work, as far as is known."""
    endpoint = event.endpoint
    if isinstance(event, LinkUp):
        up.add(endpoint)
        return UP.get(endpoint.partition(":")[0], "{} open").format(endpoint)
    if endpoint not in up:
        return f"{endpoint}: {event.reason}; trying again"
    up.discard(endpoint)
    return f"{endpoint} lost: {event.reason}; trying again"
