"""The viewer's process: Rerun's window, or its page for a browser, on loopback only."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from urllib.parse import quote

from estimator.errors import InputError
from service.process import end_with_parent

HOST = "127.0.0.1"
WEB_PORT = 9090  # Rerun's own; a free one if it is taken
START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 2.0
LIVE_HISTORY = "2MB"  # a minute or two


class ViewerProcess:
    """A child that ends with us, also when we are killed (on Linux).

    With ``live`` a page that is opened late is not sent all that was before: it would show the past
    until it has taken it in.
    Start it from the main thread: the kernel ties the child to the thread that started it.

    Raises:
        InputError: no screen for a window, or Rerun does not start.
    """

    def __init__(self, *, web: bool, live: bool = False) -> None:
        screens = map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))
        if sys.platform.startswith("linux") and not (web or any(screens)):
            raise InputError("--view: no screen here; --view web serves a page for a browser")
        # removed also if something interrupts the start; the child itself ends with us
        self._folder = tempfile.TemporaryDirectory(prefix="fuzzbee-", ignore_cleanup_errors=True)
        self.page: str | None = None  # what a browser opens, if it is no window
        try:
            self._open(WEB_PORT if web else None, live=live)
        except InputError:  # two that start at the same moment find the same ports free
            self._open(0 if web else None, live=live)

    @property
    def has_ended(self) -> bool:
        """Whether it has ended by itself: the window was closed."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Wait until it has ended by itself."""
        self._process.wait()

    def close(self) -> None:
        """End the viewer and remove its folder."""
        self._process.terminate()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def _open(self, web_port: int | None, *, live: bool) -> None:
        ports = [_free_port(0)]
        self.url = f"rerun+http://{HOST}:{ports[0]}/proxy"  # where records go
        arguments = ["--bind", HOST, "--port", str(ports[0]), "--memory-limit", "2GB"]
        if web_port is None:
            arguments += ["--hide-welcome-screen", "--expect-data-soon"]
        else:
            ports.append(_free_port(web_port))
            arguments += ["--serve-web", "--web-viewer-port", str(ports[1])]
            arguments += ["--server-memory-limit", LIVE_HISTORY] if live else []
            self.page = f"http://{HOST}:{ports[1]}/?url={quote(self.url, safe='')}"
        # Rerun must send no usage figures. As if for continuous integration it keeps none, either,
        # while `rerun analytics disable` sends those of its last run before it obeys.
        quiet = {"CI": "1", "XDG_CONFIG_HOME": self._folder.name, "RUST_LOG": "error"}
        self._errors = Path(self._folder.name) / "errors"
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(  # noqa: S603
                [program(), *arguments],
                env={**os.environ, **quiet},
                stderr=errors,
                # one call into the C library
                preexec_fn=end_with_parent,  # noqa: PLW1509
                # in a group of its own, so that Ctrl-C does not end it before the last records
                process_group=0,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        self._wait_for(ports)

    def _wait_for(self, ports: list[int]) -> None:
        end_s = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < end_s and not self.has_ended:
            with suppress(OSError):
                for port in ports:
                    socket.create_connection((HOST, port)).close()
                return
            time.sleep(0.05)
        lines = self._errors.read_text("utf-8", "replace").split("\n")
        reason = next((line for line in reversed(lines) if line.strip()), "no answer")
        self._process.kill()
        self._process.wait()
        raise InputError(f"the viewer did not start: {reason[:200]}")


def program() -> Path:
    """Rerun's own program, not the Python script that starts it: signals must reach it."""
    return Path(import_module("rerun_cli").__file__ or "").with_name("rerun")


def _free_port(wanted: int) -> int:
    """The wanted port if nobody listens there, else a free one."""
    with socket.socket() as probe:
        try:
            probe.bind((HOST, wanted))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
