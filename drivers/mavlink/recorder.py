"""Records every frame that a link lets in, in the background, to a file or to a folder of files.

A slow disk must not make attitudes late, so a thread of the recorder writes, ten times a second.
Frames are lost only where the disk fails or stands still for long; each is counted.
"""

import logging
import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from drivers.mavlink.tlog_file import STAMP_BYTES, TlogFile, cannot_record
from drivers.resources import Closing
from estimator.errors import InputError

MOST_WAITING_BYTES = 32_000_000  # a disk that stands still for longer costs frames
WRITE_EVERY_S = 0.1
CLOSE_S = 2.0
RETRY_US = 10_000_000  # a failed write is tried again then; until then no time is lost on it
MAX_FILE_BYTES = 64_000_000  # of a file in a folder: about two hours of one vehicle at 100 Hz
MAX_FILE_US = 3_600_000_000

_logger = logging.getLogger(__name__)


class _Batch(NamedTuple):
    """Whole records of frames that arrived together."""

    arrival_us: int
    records: bytes
    frames: int


class Recorder(Closing):
    """Takes frames from any thread and writes them as a tlog, or as one tlog after the other.

    With ``in_folder`` the target is a folder, which is made if need be; a file's name there is the
    UTC time of its first record, and nothing is ever deleted. ``lost`` counts frames that were not
    written. Failures are logged, never raised.

    Raises:
        InputError: the file or folder cannot be made or written, or another recorder has it.
    """

    def __init__(self, target: str | Path, *, in_folder: bool = False) -> None:
        self._writer = _Writer(Path(target), in_folder)
        self._too_many = 0  # frames for which there was no room
        self._waiting: list[_Batch] = []
        self._waiting_bytes = 0
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mavlink-recorder", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Frames that could not be written so far."""
        return self._too_many + self._writer.lost

    @property
    def is_whole(self) -> bool:
        """Whether every frame is in the files, which nobody else has damaged."""
        return not self.lost and not self._writer.is_damaged

    def write(self, arrival_us: int, frames: Sequence[bytes]) -> None:
        """Record frames that arrived together; returns at once."""
        if not frames:
            return
        stamp = arrival_us.to_bytes(STAMP_BYTES, "big")
        records = b"".join([stamp + frame for frame in frames])
        with self._lock:
            is_full = self._waiting_bytes + len(records) > MOST_WAITING_BYTES
            if not is_full and not self._closing.is_set():
                self._waiting.append(_Batch(arrival_us, records, len(frames)))
                self._waiting_bytes += len(records)
                return
            if not self._too_many:
                _logger.warning("the recording lacks frames: the disk does not keep up")
            self._too_many += len(frames)

    def close(self) -> None:
        """Write what waits, for at most two seconds, and end."""
        self._closing.set()
        self._thread.join(CLOSE_S)
        with self._lock:
            if self._thread.is_alive():  # its own last batch may be lost as well
                self._too_many += 1 + sum(batch.frames for batch in self._waiting)
                self._waiting.clear()

    def _work(self) -> None:
        is_over = False
        while not is_over:
            is_over = self._closing.wait(WRITE_EVERY_S)
            with self._lock:
                batches, self._waiting, self._waiting_bytes = self._waiting, [], 0
            # batches of one second are one write
            for _, group in groupby(batches, lambda batch: batch.arrival_us // 1_000_000):
                arrivals_us, records, frames = zip(*group, strict=True)
                self._writer.write(_Batch(arrivals_us[0], b"".join(records), sum(frames)))
            self._writer.look()
        self._writer.close()


class _Writer:
    """Appends to a tlog, or to the newest one of a folder; a full disk costs frames.

    Raises:
        InputError: the folder cannot be made or written.
    """

    def __init__(self, target: Path, in_folder: bool) -> None:
        self.lost = 0  # frames
        self.is_damaged = False
        self._target, self._in_folder = target, in_folder
        self._file: TlogFile | None = None
        self._begun_us = 0  # the file in the folder
        self._damage = ""  # what another program has done to the file
        self._retry_us: int | None = None
        if not in_folder:
            self._file = TlogFile(target)
            return
        try:
            target.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise cannot_record(f"the folder {str(target)!r}", error) from error
        if not os.access(target, os.W_OK | os.X_OK):
            raise InputError(f"cannot record to the folder {str(target)!r}: Permission denied")

    def write(self, batch: _Batch) -> None:
        """Append the records, unless a failure is too recent."""
        if self._retry_us is not None and 0 < self._retry_us - batch.arrival_us < RETRY_US:
            self.lost += batch.frames
            return
        try:
            self._prepared(batch.arrival_us).append(batch.records)
        except (OSError, InputError) as error:
            self.lost += batch.frames
            if self._retry_us is None:
                why = getattr(error, "strerror", None) or error
                _logger.warning("cannot record to %s: %s; the estimate goes on", self._path, why)
            self._retry_us = batch.arrival_us + RETRY_US
            return
        if self._retry_us is not None:
            self._retry_us = None
            _logger.warning("recording to %s again; %d frames are missing", self._path, self.lost)

    def look(self) -> None:
        """Notice what another program has done to the file."""
        if self._file is None or not (damage := self._file.damage()):
            return
        if not self._damage:
            text = "%s was %s by another program: the recording is not whole"
            _logger.warning(text, self._file.path, damage)
        self.is_damaged, self._damage = True, damage

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    @property
    def _path(self) -> Path:
        return self._target if self._file is None else self._file.path

    def _prepared(self, arrival_us: int) -> TlogFile:
        """The file; a new one where it was taken away, or where a folder's is long enough."""
        self.look()
        file, is_gone = self._file, self._damage in ("removed", "replaced")
        if file is not None and not is_gone:
            is_long = abs(arrival_us - self._begun_us) >= MAX_FILE_US
            if not (self._in_folder and (is_long or file.size >= MAX_FILE_BYTES)):
                return file
        try:
            following = TlogFile(self._following_path(arrival_us))
        except InputError as error:
            if file is None or is_gone:
                raise
            _logger.warning("%s; going on in %s", error, file.path)
        else:
            self.close()
            self._file, self._damage = following, ""
            file = following
        self._begun_us = arrival_us
        return file

    def _following_path(self, arrival_us: int) -> Path:
        """Where to go on: in the file that was, or in a folder's file of that time."""
        if not self._in_folder:
            return self._target
        start = datetime.fromtimestamp(arrival_us / 1e6, UTC).strftime("%Y%m%dT%H%M%SZ")
        path, number = self._target / f"{start}.tlog", 1
        with suppress(OSError):  # opening it reports any other error
            self._target.mkdir(parents=True, exist_ok=True)  # a file may have gone with its folder
            while True:
                try:
                    path.touch(0o644, exist_ok=False)  # at once: another run may look, too
                    break
                except FileExistsError:
                    number += 1
                    path = self._target / f"{start}-{number}.tlog"
        return path
