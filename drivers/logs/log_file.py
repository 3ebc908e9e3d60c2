"""What all logs have in common."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.closing import Closing
from drivers.logs.file_digest import file_sha256
from estimator.errors import InputError

Buffer = mmap.mmap | bytes


class LogFile(Closing):
    """A log's file: open only while it is iterated, so that there is nothing to close."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def close(self) -> None:
        """Nothing is held between one reading and the next."""

    def sha256(self) -> str:
        """The file's SHA-256, as hexadecimal digits."""
        return file_sha256(self.path)


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap]:
    """The file's content without reading it into memory.

    Raises:
        InputError: the file is empty, which cannot be mapped.
    """
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield data
