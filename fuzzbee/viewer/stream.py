"""Sends what is drawn to Rerun's viewer, to a file, or to both."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from estimator.errors import InputError
from fuzzbee.recordings import NotWholeError
from fuzzbee.viewer.process import ViewerProcess
from fuzzbee.viewer.sdk import bindings, rr
from service.signals import terminate_like_interrupt

WEB = "web"
CLOSE_FLUSH_S = 0.4  # less than the time that all sinks of a run have to close
FINISH_FLUSH_S = 60.0
CLOSED = "closed; the rest goes on without it"
CHECK_EVERY = 50  # pieces: whether the file is still written
OF_FILE = "File-writer"  # begins what the library says of a file that it could not write


class ViewerOptions(NamedTuple):
    """What was asked for: a window or "web", or None; a file, or None. Live, the past is less."""

    view: str | None = None
    rrd: str | None = None
    live: bool = False


class ViewerStream:
    """A recording, and the viewer's process if one was asked for.

    ``blueprint`` says what is shown where.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    def __init__(self, options: ViewerOptions, blueprint: Callable[[], Any]) -> None:
        self._recording: Any = rr.RecordingStream("fuzzbee", send_properties=False)
        self._recording.set_log_time_enabled(False)  # what is drawn has a time of its own
        self._recording.set_log_tick_enabled(False)
        self.process: ViewerProcess | None = None
        self._rrd = options.rrd
        self._file_failed = False
        self._pieces = 0
        self._told = False
        sinks = [] if options.rrd is None else [_file_sink(options.rrd, live=options.live)]
        if options.view is not None:
            self.process = ViewerProcess(web=options.view == WEB, live=options.live)
            sinks.append(rr.GrpcSink(self.process.url))
        self._recording.set_sinks(*sinks, default_blueprint=blueprint())

    @property
    def page(self) -> str | None:
        """The address for a browser."""
        return None if self.process is None else self.process.page

    @property
    def is_wanted(self) -> bool:
        """Whether there is still somewhere to draw."""
        has_file = self._rrd is not None and not self._file_failed
        return has_file or (self.process is not None and not self._is_lost)

    def take_loss(self) -> bool:
        """Whether somebody else has closed the viewer; True only once."""
        lost = self._is_lost and not self._told
        self._told = self._told or lost
        return lost

    @property
    def _is_lost(self) -> bool:
        return self.process is not None and self.process.has_ended

    def at(self, timeline: str, **time: Any) -> None:
        """Set the time of all that is logged from now on: ``timestamp`` in s, or ``sequence``."""
        self._recording.set_time(timeline, **time)

    def log(self, path: str, shape: Any) -> None:
        """Show ``shape`` from the time that was set on."""
        self._recording.log(path, shape)
        self._pieces += 1
        if self._rrd is not None and self._pieces % CHECK_EVERY == 0:
            self._flush(0.0)

    @property
    def is_whole(self) -> bool:
        """Whether the file, if there is one, has everything so far."""
        return not self._file_failed

    def require_whole(self) -> None:
        """Raise once if the file is not.

        Raises:
            NotWholeError: it is not, so it is written no more.
        """
        if self._file_failed and self._rrd is not None:
            rrd, self._rrd = self._rrd, None
            raise NotWholeError(f"--rrd {rrd}: could not be written, and is not whole")

    def static(self, path: str, shape: Any) -> None:
        """Show ``shape`` at all times."""
        self._recording.log(path, shape, static=True)

    def curves(self, path: str, column: Any, values: list[list[float]]) -> None:
        """Points (T, lines) of several lines in one piece, at the times of a column (T,)."""
        columns = rr.Scalars.columns(scalars=values)
        self._recording.send_columns(path, indexes=[column], columns=columns)

    def show(self, blueprint: Any) -> None:
        """Arrange the views anew."""
        arrangement = _Arrangement(blueprint)
        with self._noting_failures():
            self._recording.send_blueprint(arrangement)
            arrangement.let_go()

    def lines(self, path: str, names: list[str], colours: list[Any]) -> None:
        """Names and colours of lines."""
        self.static(path, rr.SeriesLines(names=names, colors=colours))

    def finish(self) -> None:
        """Send what is pending and leave the viewer open."""
        self._flush(FINISH_FLUSH_S)

    def stay_open(self) -> None:
        """Wait until the window is closed or Ctrl-C is pressed; not at all without a viewer."""
        with terminate_like_interrupt(), suppress(KeyboardInterrupt):
            if self.process is not None:
                self.process.wait(lambda: False)

    def close(self) -> None:
        """Send what is pending, and end the viewer."""
        self._flush(CLOSE_FLUSH_S)
        self._recording.disconnect()
        if self.process is not None:
            self.process.close()
            self.process = None

    def _flush(self, timeout_s: float) -> None:
        """Send what is pending."""
        with self._noting_failures():
            self._recording.flush(timeout_sec=timeout_s)

    @contextmanager
    def _noting_failures(self) -> Iterator[None]:
        """The window may be closed already, and the disk be full."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - the library's errors have no class of their own
            if self._rrd is not None and str(error).startswith(OF_FILE):
                self._file_failed = True


class _Arrangement:
    """A blueprint, and what the library makes of it to send it.

    It writes it into a stream that nobody closes (0.41): two threads and 2 MB each time.
    """

    def __init__(self, blueprint: Any) -> None:
        self._blueprint = blueprint
        self._stream: Any = None

    def to_blueprint(self) -> "_Arrangement":
        return self

    def _log_to_stream(self, stream: Any) -> None:
        self._stream = stream
        self._blueprint._log_to_stream(stream)  # noqa: SLF001 - the library's own

    def let_go(self) -> None:
        """Close that stream. Behind a file on a full disk the library sometimes waits for ever."""
        closing = threading.Thread(target=self._close, name="viewer page", daemon=True)
        closing.start()
        closing.join(CLOSE_FLUSH_S)

    def _close(self) -> None:
        if self._stream is not None:
            self._stream.disconnect()
            self._stream = None
        bindings.flush_and_cleanup_orphaned_recordings()


def _file_sink(path: str, *, live: bool) -> Any:
    """Live without an index at the file's end, which is kept in memory: 100 MB an hour."""
    try:
        Path(path).write_bytes(b"")  # Rerun would only log an error
    except OSError as error:
        raise InputError(f"--rrd {path}: {error.strerror}") from error
    if not live:
        return rr.FileSink(path)
    try:
        return rr.FileSink(path, write_footer=False)
    except TypeError:  # an older library, which has none
        return rr.FileSink(path)
