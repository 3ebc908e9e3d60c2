"""Lines about one vehicle, no more than a person can read."""

MOST_LINES = 12  # in a minute; the next one says that there are more, and then it is quiet
MINUTE_US = 60_000_000


class Talk:
    """Passes lines on until there are too many. Time comes in as an argument."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._since_us: int | None = None
        self._lines = 0

    def lines(self, texts: list[str], now_us: int) -> list[str]:
        """What is to be said of ``texts`` at ``now_us``."""
        if self._since_us is None or not 0 <= now_us - self._since_us < MINUTE_US:
            held = max(0, self._lines - MOST_LINES)
            self._since_us, self._lines = now_us, 0
            if held:
                texts = [f"{self._who}: {held} lines were not told", *texts]
        said = []
        for text in texts:
            self._lines += 1
            if self._lines <= MOST_LINES:
                said.append(text)
            elif self._lines == MOST_LINES + 1:
                said.append(f"{self._who}: and so on, more is not told for a minute")
        return said
