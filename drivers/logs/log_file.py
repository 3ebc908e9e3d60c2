"""What all logs have in common."""

import hashlib
import logging
import mmap
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from drivers.closing import Closing
from drivers.events import Event
from drivers.memory import available_bytes
from estimator.errors import InputError

Buffer = mmap.mmap | bytes
READ_SIZE = 1 << 22
MARGIN = 1 << 16  # bytes; longer than any message of a log that is read in pieces
LARGEST = 4 << 30  # bytes: a day at several hundred hertz
# What a log that is read whole takes of memory, of its size: 1.42 were measured, by its tables.
WHOLE_TAKES = 1.5

_log = logging.getLogger(__name__)


class LogFile(Closing):
    """A recording as the events of a live link, for as often as it is iterated.

    The file is open only while it is iterated, so that there is nothing to close.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def __iter__(self) -> Iterator[Event]:
        """The events from the file's start."""

    def close(self) -> None:
        """Do nothing: no file is held open between two readings."""

    def sha256(self) -> str:
        """The file's SHA-256, as hexadecimal digits."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


class Window:
    """A part of a file in memory, which moves forwards: a log may be larger than the memory.

    ``data`` begins where the last :meth:`move` said; ``is_last`` tells that nothing follows it.
    """

    def __init__(self, data: bytes = b"", file: BinaryIO | None = None) -> None:
        self.data = data
        self._file = file
        self.is_last = file is None

    def move(self, position: int) -> int:
        """Forget what is before ``position`` of the data, and read on; where that place is now."""
        kept = self.data[position:]
        try:
            more = b"" if self._file is None else self._file.read(READ_SIZE)
        except OSError as error:
            more = b""
            _log.warning("%s: read no further: %s", getattr(self._file, "name", ""), error.strerror)
        self.is_last = not more
        self.data = kept + more
        return 0

    def is_near_end(self, position: int) -> bool:
        """Whether to move on before what is at ``position`` is looked at."""
        return not self.is_last and position > len(self.data) - MARGIN


@contextmanager
def windowed(path: Path) -> Iterator[Window]:
    """The file from its start, in pieces.

    Raises:
        InputError: the file is empty or cannot be read.
    """
    try:
        with path.open("rb", buffering=0) as file:
            window = Window(file=file)
            window.move(0)
            if not window.data:
                raise InputError(f"{path}: the file is empty")
            yield window
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


@contextmanager
def whole_file(path: Path) -> Iterator[Buffer]:
    """The file's content, in memory of our own.

    A file mapped into memory ends the process without a word (SIGBUS) if it shrinks, or its
    card or network share fails, while it is looked at. Here that is a short reading: what was
    read so far counts, and a line in the log tells.

    Raises:
        InputError: the file is empty, cannot be read, or is larger than any log or than there is
            memory for.
    """
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: the file is empty")
    if size > LARGEST:
        raise InputError(f"{path}: has more than {LARGEST >> 30} GiB: cut it into parts")
    if WHOLE_TAKES * size > (there := available_bytes()):
        takes, has = (f"{value / (1 << 20):.0f} MiB" for value in (WHOLE_TAKES * size, there))
        raise InputError(f"{path}: takes {takes} of memory, of which {has} are there: cut it")
    with mmap.mmap(-1, size) as content:
        read, fault = _read_into(content, path)
        if read == 0:
            raise InputError(f"{path}: cannot be read: {fault}")
        if read < size:
            _log.warning("%s: read %d of %d bytes: %s", path, read, size, fault)
        yield content if read == size else content[:read]


def _read_into(content: mmap.mmap, path: Path) -> tuple[int, str]:
    """Fill ``content`` from the file; how many bytes came, and why not all."""
    read = 0
    try:
        with path.open("rb", buffering=0) as file, memoryview(content) as view:
            while read < len(view):
                count = file.readinto(view[read : read + READ_SIZE])
                if not count:
                    return read, "it has become shorter"
                read += count
    except OSError as error:
        return read, error.strerror or str(error)
    return read, ""
