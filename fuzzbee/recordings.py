"""The files that a run was asked to record to, and whether all of them are whole so far."""

from collections.abc import Iterable
from typing import Any

WHOLE, FAILED = "whole", "failed"


class Recordings:
    """Asked for a word at each status; called by the loop's thread."""

    def __init__(self) -> None:
        self._files: list[Any] = []

    def add(self, things: Iterable[Any]) -> None:
        """Watch those of the things that keep a file, which have ``is_whole``."""
        self._files += [each for each in things if hasattr(each, "is_whole")]

    @property
    def word(self) -> str:
        """``whole``, ``failed``, or empty where nothing is recorded."""
        if not self._files:
            return ""
        return WHOLE if all(each.is_whole for each in self._files) else FAILED
