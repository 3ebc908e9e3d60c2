"""Sends what is drawn to Rerun's viewer, to a file, or to both.

Rerun's library is imported here only, and this module only where a viewer is asked for.
"""

import atexit
import os
from concurrent.futures import Future, wait
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from drivers.output_file import NotWholeError
from drivers.resources import run_in_thread
from estimator.errors import InputError
from fuzzbee.notify import notify
from fuzzbee.viewer.process import ViewerProcess
from service.signals import terminate_like_interrupt

# The library logs errors, but not that the viewer is gone or a file not written: we report those.
OURS = ("re_grpc_client", "re_sdk::recording_stream", "re_log_encoding")
os.environ.setdefault("RUST_LOG", ",".join(["error", *(f"{name}=off" for name in OURS)]))
rr: Any = import_module("rerun")
rrb: Any = import_module("rerun.blueprint")
# It waits at the process's end for what is pending, behind a full disk for ever; we close it.
atexit.unregister(rr.rerun_shutdown)

TIMELINE = "time"
CLOSE_FLUSH_S = 0.4  # less than the time that all sinks of a run have to close
FINISH_FLUSH_S = 60.0
FILE_OPEN_S = 5.0  # for the arrangement of the views, 60 kB
CLOSED = "closed; the rest goes on without it"
STALLED_S = 10.0  # a file that has not grown for so long is given up
INDEX, LONGEST_END = b"FOOT", 64  # a mark in the last bytes of a file that has an index
# So begins what the library prints of a file that it could not write, later or at once.
OF_FILE = ("File-writer", "Failed to encode LogMsg")


class ViewerStream:
    """Rerun's ``recording``, and the viewer's process if one was asked for.

    ``view`` is "window" or "web", ``rrd`` a file, and ``blueprint`` what is shown where; live, the
    past is less. What may wait for ever, as where a disk is full, is done in threads that are left
    behind if it takes too long.

    Raises:
        InputError: the viewer does not start, or the file cannot be written.
    """

    def __init__(
        self, blueprint: Any, view: str | None, rrd: str | None, *, live: bool = False
    ) -> None:
        # into a file alone at a flush only: many points a chunk; eyes get theirs every 0.2 s
        batches = rr.ChunkBatcherConfig.NEVER() if view is None else None
        self.recording: Any = rr.RecordingStream(
            "fuzzbee", send_properties=False, batcher_config=batches
        )
        self.recording.set_log_time_enabled(False)  # what is drawn has a time of its own
        self.recording.set_log_tick_enabled(False)
        self.process: ViewerProcess | None = None
        self.is_whole = True  # the file, if there is one, has everything so far
        self._rrd, self.is_live = rrd, live
        sinks = [] if rrd is None else [_file_sink(rrd, live=live)]
        if view is not None:
            self.process = ViewerProcess(web=view == "web", live=live)
            sinks.append(rr.GrpcSink(self.process.url))
        opening = partial(self.recording.set_sinks, *sinks, default_blueprint=blueprint)
        opened = run_in_thread(opening, "viewer")
        self._await(opened, FINISH_FLUSH_S if rrd is None else FILE_OPEN_S)
        if self.process is not None and self.process.page is not None:
            notify(f"the viewer is at {self.process.page}")

    @property
    def is_wanted(self) -> bool:
        """Whether there is still somewhere to draw."""
        return self.process is not None or (self._rrd is not None and self.is_whole)

    def take_loss(self) -> bool:
        """Whether somebody else has closed the viewer; True only once."""
        if self.process is None or not self.process.has_ended:
            return False
        self.process.close()
        self.process = None
        return True

    def require_whole(self) -> None:
        """Raise NotWholeError, once, if the file could not be written; it is written no more."""
        if not self.is_whole and self._rrd is not None:
            rrd, self._rrd = self._rrd, None
            raise NotWholeError(f"--rrd {rrd}: could not be written, and is not whole")

    def message(self, text: str, now_us: int) -> None:
        """Show a line for a person."""
        self.recording.set_time(TIMELINE, timestamp=1e-6 * now_us)
        self.recording.log("/messages", rr.TextLog(text))

    def finish(self) -> None:
        """Send what is pending and end the file, unless that stops growing; the viewer stays."""
        flushing = self._flushing(FINISH_FLUSH_S)
        size, before = self._size(), -1
        while self._rrd is not None and not flushing.done() and size > before:
            wait([flushing], STALLED_S)
            size, before = self._size(), size
        self._await(flushing, 0.0 if self._rrd is not None else FINISH_FLUSH_S)
        if self.is_whole:  # what a full disk holds up would be waited for in vain
            self._disconnect(FINISH_FLUSH_S)
        if self.is_whole:
            self._rrd = None  # it is finished, however long it takes to close the viewer

    def stay_open(self) -> None:
        """Wait until the window is closed or Ctrl-C is pressed; not at all without a viewer."""
        with terminate_like_interrupt(), suppress(KeyboardInterrupt):
            if self.process is not None:
                self.process.wait()

    def close(self) -> None:
        """Send what is pending, end the viewer, and raise if the file is not whole."""
        self.flush(CLOSE_FLUSH_S)
        self._disconnect(CLOSE_FLUSH_S)
        if self.process is not None:
            self.process.close()
            self.process = None
        self.require_whole()

    def flush(self, timeout_s: float = 0.0) -> None:
        """Send what is pending, and wait so long until it is."""
        self._await(self._flushing(timeout_s), timeout_s + CLOSE_FLUSH_S)

    def _flushing(self, timeout_s: float) -> "Future[Any]":
        return run_in_thread(partial(self.recording.flush, timeout_sec=timeout_s), "viewer")

    def _size(self) -> int:
        """The file's size; 0 without one."""
        with suppress(OSError):
            return Path(self._rrd or "").stat().st_size
        return 0

    def _disconnect(self, timeout_s: float) -> None:
        """End the file, for which there may be no room left; the library only logs that."""
        self._await(run_in_thread(self.recording.disconnect, "viewer"), timeout_s)
        # a live file has no index
        if self._rrd is not None and not self.is_live and (file := Path(self._rrd)).is_file():
            with file.open("rb") as written:
                written.seek(max(0, file.stat().st_size - LONGEST_END))
                self.is_whole &= INDEX in written.read()

    def _await(self, work: "Future[Any]", timeout_s: float) -> None:
        """Wait for work that may never end, and note whether the file still has everything."""
        try:
            work.result(timeout_s)
        except TimeoutError:
            self.is_whole = self._rrd is None
        except Exception as error:  # noqa: BLE001 - the library's errors have no class of their own
            if self._rrd is not None and str(error).startswith(OF_FILE):
                self.is_whole = False


def _file_sink(path: str, *, live: bool) -> Any:
    """Live without an index at the file's end, which is kept in memory: 100 MB an hour."""
    if Path(path).is_fifo():
        raise InputError(f"--rrd {path}: a pipe, choose a file")
    try:
        Path(path).write_bytes(b"")  # Rerun would only log an error
    except OSError as error:
        raise InputError(f"--rrd {path}: {error.strerror}") from error
    return rr.FileSink(path, write_footer=not live)
