"""What all logs have in common."""

from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.file_digest import file_sha256


class LogFile:
    """A log's file: open only while it is iterated, so that there is nothing to close."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        return None

    def sha256(self) -> str:
        """The file's SHA-256, as hexadecimal digits."""
        return file_sha256(self.path)
