"""Arrival times for logs that were written on board and know no arrivals."""

LONGEST_HOLE_US = 600 * 1_000_000  # a longer hole in a log is taken for a leap of its clock


class LogTime:
    """What stands in for arrival times: the log's own times, but no step beyond a hole's length.

    With the log's times as they are, a garbled one would pass for a gap of
    years. The result is not meant to be published.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._arrival_us = 0

    def arrival_us(self, raw_us: int) -> int:
        """The stand-in for the arrival of a message stamped ``raw_us``."""
        if self._last_us is not None:
            self._arrival_us += min(max(raw_us - self._last_us, 0), LONGEST_HOLE_US)
        self._last_us = raw_us
        return self._arrival_us
