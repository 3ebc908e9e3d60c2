"""Records a link into a folder: one tlog after the other, none too large to carry about.

A file's name is the UTC time of its first record. Nothing is ever deleted.
"""

import logging
import os
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from drivers.closing import Closing
from drivers.mavlink.recorder import RETRY_US, Records, TlogRecorder, cannot_record
from estimator.errors import InputError

MAX_FILE_BYTES = 64_000_000  # about two hours of one vehicle at 100 Hz
MAX_FILE_US = 3_600_000_000

_logger = logging.getLogger(__name__)


class RotatingRecorder(Closing):
    """Appends frames to the newest tlog of a folder, which is made if need be.

    A full disk costs frames, never an exception: see :class:`TlogRecorder`.
    When no new file can be made, the old one goes on.

    Raises:
        InputError: the folder cannot be made or written.
    """

    def __init__(self, folder: str | Path, max_file_bytes: int = MAX_FILE_BYTES) -> None:
        self.folder = Path(folder)
        self._max_file_bytes = max_file_bytes
        self._file: TlogRecorder | None = None
        self._file_bytes = 0
        self._begun_us = 0
        self._retry_us: int | None = None
        self._lost = 0
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise cannot_record(f"the folder {str(folder)!r}", error) from error
        if not os.access(self.folder, os.W_OK | os.X_OK):
            raise InputError(f"cannot record to the folder {str(folder)!r}: Permission denied")

    @property
    def lost(self) -> int:
        """Frames that could not be written."""
        return self._lost + (0 if self._file is None else self._file.lost)

    def write(self, records: Records) -> None:
        """Append them, to the next file if it is time for it."""
        if not records.frames:
            return
        if self._is_due(records.arrival_us):
            self._rotate(records.arrival_us)
        if self._file is None:
            self._lost += records.frames
            return
        lost_before = self._file.lost
        self._file.write(records)
        if self._file.lost == lost_before:
            self._file_bytes += len(records.data)

    def close(self) -> None:
        """Close the file; later frames count as lost."""
        if self._file is not None:
            self._file.close()

    def _is_due(self, arrival_us: int) -> bool:
        if self._retry_us is not None and 0 <= self._retry_us - arrival_us < RETRY_US:
            return False
        if self._file is None or self._file_bytes >= self._max_file_bytes:
            return True
        if self._file.is_removed():
            return True
        return abs(arrival_us - self._begun_us) >= MAX_FILE_US

    def _rotate(self, arrival_us: int) -> None:
        if self._file is not None and self._file.is_removed():
            _logger.warning("%s was removed: recording to a new file", self._file.path)
            with suppress(OSError):  # perhaps with the folder
                self.folder.mkdir(parents=True, exist_ok=True)
        try:
            following = TlogRecorder(self._free_path(arrival_us))
        except InputError as error:
            if self._retry_us is None:
                _logger.warning("%s; the estimate goes on", error)
            self._retry_us = arrival_us + RETRY_US
            return
        self._retry_us = None
        if self._file is not None:
            self._lost += self._file.lost
            self._file.close()
        self._file, self._file_bytes, self._begun_us = following, 0, arrival_us

    def _free_path(self, arrival_us: int) -> Path:
        start = datetime.fromtimestamp(arrival_us / 1e6, UTC).strftime("%Y%m%dT%H%M%SZ")
        path, number = self.folder / f"{start}.tlog", 1
        with suppress(OSError):  # whoever opens it says what else is wrong
            while True:
                try:
                    path.touch(0o644, exist_ok=False)  # at once: another run may look, too
                    break
                except FileExistsError:
                    number += 1
                    path = self.folder / f"{start}-{number}.tlog"
        return path
