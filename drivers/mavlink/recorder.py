"""Records the frames of a link as a tlog, as ground stations do.

A tlog is a row of records: the arrival in Unix microseconds (8 bytes, big
endian), then the frame as it came. Each write is made of whole records and goes
straight to the operating system, so that a killed process leaves a readable
file. An existing file is continued.
"""

import errno
import logging
import os
import stat
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, NamedTuple

from drivers.closing import Closing
from drivers.output_file import output_path
from estimator.errors import InputError

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from drivers.mavlink.rotating_recorder import RotatingRecorder

RETRY_US = 10_000_000  # a failed write is tried again then; until then no time is lost on it
NOT_WAITING = getattr(os, "O_NONBLOCK", 0)

_STAMP = Struct(">Q")
_logger = logging.getLogger(__name__)


class Records(NamedTuple):
    """Whole records of frames, the last of which arrived at ``arrival_us``."""

    arrival_us: int
    data: bytes
    frames: int


def records_of(arrival_us: int, frames: Iterable[bytes]) -> Records:
    """The records of frames that arrived together."""
    stamp = _STAMP.pack(arrival_us)
    records = [stamp + frame for frame in frames]
    return Records(arrival_us, b"".join(records), len(records))


class SharedRecorder:
    """A recorder that several threads write to."""

    def __init__(self, recorder: "TlogRecorder | RotatingRecorder") -> None:
        self._recorder = recorder
        self._missed = 0
        self._lock = threading.Lock()

    def write(self, records: Records) -> None:
        """Keep them; never raises."""
        with self._lock:
            self._recorder.write(records)

    def miss(self, frames: int) -> None:
        """Count frames that could not even be handed over in time. The first ones are logged."""
        if frames and not self._missed:
            _logger.warning("the recording lacks frames: more arrives than can be taken")
        self._missed += frames

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing so far."""
        return not self._missed and not self._recorder.lost


class TlogRecorder(Closing):
    """Appends frames to a tlog; a full disk costs frames, never an exception.

    ``lost`` counts the frames that could not be written. The first failure is
    logged, and the recovery.

    Raises:
        InputError: the file cannot be opened for writing, or another recorder writes to it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = output_path(Path(path))
        self.lost = 0
        self._retry_us: int | None = None
        try:
            self._file = _opened(self.path)
        except (OSError, ValueError) as error:
            raise cannot_record(repr(str(path)), error) from error
        self._is_regular = stat.S_ISREG(os.fstat(self._file).st_mode)
        self._require_tlog()

    def _require_tlog(self) -> None:
        """Frames are appended to a tlog, to nothing else."""
        if not self._is_regular or os.fstat(self._file).st_size == 0:
            return
        with suppress(OSError), self.path.open("rb") as file:  # one may be written, not read
            start = file.read(_STAMP.size + 1)
            if start[_STAMP.size :] not in (b"\xfe", b"\xfd"):
                self.close()
                raise InputError(f"cannot record to {str(self.path)!r}: it is there, and no tlog")

    def is_removed(self) -> bool:
        """Whether the file has been removed: nothing that is written to it stays."""
        try:
            return self._is_regular and self._file >= 0 and os.fstat(self._file).st_nlink == 0
        except OSError:
            return False

    def write(self, records: Records) -> None:
        """Append them."""
        if not records.frames:
            return
        if self._file < 0 or (self._retry_us is not None and records.arrival_us < self._retry_us):
            self.lost += records.frames
            return
        self._append(records)

    def close(self) -> None:
        """Close the file; later frames count as lost."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _append(self, records: Records) -> None:
        data, written = records.data, 0
        try:
            if self.is_removed():
                self._make_again()
            written = os.write(self._file, data)
            if written == len(data):
                self._note_success()
                return
            reason = "no space left"
        except OSError as error:
            reason = error.strerror or str(error)
        self._drop_half_record(written)
        self.lost += records.frames
        if self._retry_us is None:
            _logger.warning("cannot record to %s: %s; the estimate goes on", self.path, reason)
        self._retry_us = records.arrival_us + RETRY_US

    def _make_again(self) -> None:
        """In place of a removed file a new one of the same name, where there is a folder for it."""
        again = _opened(self.path)
        os.close(self._file)
        self._file = again
        _logger.warning("%s was removed: recording to a new file of that name", self.path)

    def _drop_half_record(self, written: int) -> None:
        if written and self._is_regular:
            try:
                os.ftruncate(self._file, os.fstat(self._file).st_size - written)
            except OSError as error:
                _logger.warning("%s may end in half a record: %s", self.path, error.strerror)

    def _note_success(self) -> None:
        if self._retry_us is not None:
            self._retry_us = None
            _logger.warning("recording to %s again; %d frames are missing", self.path, self.lost)


def _opened(path: Path) -> int:
    """The file, for one recorder alone; the system takes that back however its process ends."""
    # a pipe that nobody reads would block
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | NOT_WAITING, 0o644)
    os.set_blocking(file, True)
    try:
        if fcntl is not None and stat.S_ISREG(os.fstat(file).st_mode):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise OSError(errno.EBUSY, "another program records to it") from None
    except OSError:
        pass  # a file system without locks
    return file


def cannot_record(where: str, error: Exception) -> InputError:
    """What to raise when ``where`` cannot be opened for recording."""
    return InputError(f"cannot record to {where}: {getattr(error, 'strerror', None) or error}")
