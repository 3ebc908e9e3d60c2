"""Repeated errors as few lines: the first at once, then a count."""

REPEAT_S = 60.0  # an error that goes on is mentioned this often


class ErrorSummary:
    """Decides which repetitions of an error are worth a line. Time comes in as an argument."""

    def __init__(self) -> None:
        self._reason = ""
        self._count = 0
        self._said_s = 0.0

    def line(self, reason: str, now_s: float) -> str | None:
        """What to say about ``reason`` now: the reason, the reason with its count, or nothing."""
        if reason != self._reason:
            self._reason, self._count, self._said_s = reason, 1, now_s
            return reason
        self._count += 1
        if now_s - self._said_s < REPEAT_S:
            return None
        self._said_s = now_s
        return f"{reason} ({self._count} times)"

    def clear(self) -> int:
        """Forget the error, because it is over; returns how often it was seen."""
        count, self._reason, self._count = self._count, "", 0
        return count
