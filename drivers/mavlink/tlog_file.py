"""One telemetry log that frames are appended to.

A tlog is a row of records: the arrival in Unix microseconds (8 bytes, big endian), then the frame
as it came. Each write is made of whole records and goes straight to the operating system, so that
a killed process leaves a readable file. An existing file is continued.
"""

import errno
import os
import stat
from contextlib import suppress
from io import FileIO
from pathlib import Path

from drivers.output_file import output_path
from drivers.resources import Closing
from estimator.errors import InputError

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

NOT_WAITING = getattr(os, "O_NONBLOCK", 0)
STAMP_BYTES = 8


def cannot_record(where: str, error: Exception) -> InputError:
    """What to raise when ``where`` cannot be opened for recording."""
    return InputError(f"cannot record to {where}: {getattr(error, 'strerror', None) or error}")


class TlogFile(Closing):
    """A tlog, open for appending, for one writer alone.

    Raises:
        InputError: the file cannot be opened for writing, another recorder writes to it, or it
            is there and no tlog.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = output_path(Path(path))
        try:
            self._file = _opened(self.path)
        except (OSError, ValueError) as error:
            raise cannot_record(repr(str(path)), error) from error
        about = os.fstat(self._file.fileno())
        self._is_regular = stat.S_ISREG(about.st_mode)
        self.size = about.st_size  # as this writer leaves it
        if self._is_regular and self.size and not self._is_tlog():
            self.close()
            raise InputError(f"cannot record to {str(self.path)!r}: it is there, and no tlog")

    def append(self, records: bytes) -> None:
        """Append whole records, or none of them.

        Raises:
            OSError: they could not be written.
        """
        written = self._file.write(records)
        if written < len(records):
            if self._is_regular:
                self._file.truncate(os.fstat(self._file.fileno()).st_size - written)
            raise OSError(errno.ENOSPC, "no space left")
        self.size += written

    def damage(self) -> str:
        """What another program has done to the file, in one word; empty if nothing.

        It is ``removed``, ``replaced``, ``truncated`` or ``changed``, the last for a file that is
        longer than it should be.
        """
        if not self._is_regular:
            return ""
        try:
            about, there = os.fstat(self._file.fileno()), self.path.stat()
        except OSError:
            return "removed"
        if (there.st_dev, there.st_ino) != (about.st_dev, about.st_ino):
            return "replaced"
        if about.st_size != self.size:
            return "truncated" if about.st_size < self.size else "changed"
        return ""

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _is_tlog(self) -> bool:
        """Whether a frame is behind the first time; of a file that cannot be read nobody knows."""
        with suppress(OSError), self.path.open("rb") as file:
            return file.read(STAMP_BYTES + 1)[STAMP_BYTES:] in (b"\xfe", b"\xfd")
        return True


def _opened(path: Path) -> FileIO:
    """The file, for one recorder alone; the system takes that back however its process ends."""
    # a pipe that nobody reads would block
    file = FileIO(path, "ab", opener=lambda name, flags: os.open(name, flags | NOT_WAITING, 0o644))
    os.set_blocking(file.fileno(), True)
    try:
        if fcntl is not None and stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise OSError(errno.EBUSY, "another program records to it") from None
    except OSError:
        pass  # a file system without locks
    return file
