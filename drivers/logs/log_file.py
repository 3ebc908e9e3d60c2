"""What all logs have in common."""

import hashlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from drivers.events import Event, ImuInUse, VehicleId
from drivers.resources import Closing
from estimator.errors import InputError

T = TypeVar("T")
OnRead = Callable[[int], None]
READ_SIZE = 1 << 20
LATEST_US = 1 << 62  # differences between times must fit 64 bits
MARGIN = 1 << 17  # bytes; longer than any message of a log that is read in pieces

_log = logging.getLogger(__name__)


class LogFile(Closing, ABC):
    """A recording as the events of a live link, for as often as it is iterated.

    The file is open only while it is iterated, so that there is nothing to close. ``on_read`` is
    called with the bytes that are done with, if it is read in pieces.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.on_read: OnRead | None = None
        self.imu_in_use: ImuInUse | None = None

    def follow(self, imu_in_use: ImuInUse) -> None:
        """Skip a vehicle's other IMU messages, as a live link does."""
        self.imu_in_use = imu_in_use

    @abstractmethod
    def __iter__(self) -> Iterator[Event]:
        """The events from the file's start."""

    def readings(self, _names: frozenset[str]) -> Iterator[tuple[VehicleId, str, int, Any]]:
        """Messages as logged: sender, name, arrival, and what has the fields as attributes.

        There are none where the log's format has none that :mod:`other_sensors` asks for.
        """
        return iter(())

    def advice(self, system_id: int | None = None) -> str | None:
        """One line for a log without IMU data: what there is instead, and how to get a better one.

        None if there is not even an attitude (of that system), or an IMU message that is of no use.
        """

    def sha256(self) -> str:
        """The file's SHA-256, as hexadecimal digits."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


class Window:
    """A part of a file in memory, which moves forwards: a log may be larger than the memory.

    ``data`` begins at the place of the last :meth:`move`, ``offset`` bytes behind the file's start;
    ``is_last`` shows that nothing follows it.
    """

    def __init__(self, file: BinaryIO, on_read: OnRead | None = None) -> None:
        self.data = b""
        self._file = file
        self._on_read = on_read
        self.offset = 0
        self.is_last = False
        self._safe_end = 0  # where the records end that are surely all there

    def move(self, position: int) -> int:
        """Forget what is before ``position`` of the data, and read on; where that place is now."""
        kept = self.data[position:]
        self.offset += position
        if self._on_read is not None:
            self._on_read(self.offset)
        try:
            more = self._file.read(READ_SIZE)
        except OSError as error:
            if not self.data:
                raise
            more = b""
            _log.warning("%s: read no further: %s", getattr(self._file, "name", ""), error.strerror)
        self.is_last, self.data = not more, kept + more
        self._safe_end = len(self.data) - MARGIN * bool(more)
        return 0

    def records(
        self,
        position: int,
        read: Callable[[int], tuple[int, Sequence[T | None]]],
        search: Callable[[int], int | None],
    ) -> Iterator[T | None]:
        """What ``read`` finds from ``position`` on; None for each damaged stretch.

        It takes the record at a place of the data, and returns where the next one should begin, the
        same place if it is damaged, and what it has found: one thing, or nothing that is wanted.
        ``search`` finds the next sound record behind damage, from a place on.
        """
        while position < len(self.data) or not self.is_last:
            if position >= self._safe_end:
                position = self.move(position)
                continue
            begin = position
            position, found = read(position)
            if found:  # to iterate over nothing takes longer, and most records are not wanted
                yield found[0]
            if position == begin:
                yield None
                position = self._next(position + 1, search)

    def _next(self, position: int, search: Callable[[int], int | None]) -> int:
        """Where the next sound record begins, or the data's end.

        One that begins near the end may go on behind it, so the data move on until it is found.
        """
        while (start := search(position)) is None or start >= self._safe_end:
            if self.is_last:
                return len(self.data)
            position = self.move(max(position, self._safe_end))
        return start

    def end(self) -> None:
        """Read no further."""
        self.is_last, self._safe_end = True, len(self.data)


@contextmanager
def windowed(path: Path, on_read: OnRead | None = None) -> Iterator[Window]:
    """The file from its start, in pieces.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with path.open("rb", buffering=0) as file:
            window = Window(file, on_read)
            window.move(0)
            yield window
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
