"""The service's side of the nursery: started, asked for workers, heard, ended."""

import os
import pickle
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from struct import Struct
from typing import NamedTuple

from drivers.closing import Closing
from estimator.profile import Profile
from service.offspring import is_stopped

# What the process runs: our own modules, from wherever this process has them.
PROGRAM = (
    "import sys; sys.path[:] = {path!r}; "
    "from service.workers.nursery import serve; serve({control})"
)
# Libraries for matrices start a thread for each core, of which a fork would copy none.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
ENDING_S = 2.0


# What both say to each other
REQUEST = Struct("<I")  # the number of a worker; its end of a connection comes along
NEWS = Struct("<cii")  # what, process, number of the worker or exit status
READY, BORN, DEAD = b"R", b"B", b"D"


class Setup(NamedTuple):
    """What to compile before the first worker."""

    profile: Profile
    gain: float | None


class News(NamedTuple):
    """Something that the nursery tells; ``what`` is READY, BORN or DEAD."""

    what: bytes
    process: int
    number: int


class NurseryProcess(Closing):
    """A nursery in a session of its own: what a terminal signals does not reach it."""

    def __init__(self, setup: Setup) -> None:
        self.is_ready = False
        self.is_ended = False
        self._received = b""
        self.control, theirs = socket.socketpair()
        with theirs:
            program = PROGRAM.format(path=sys.path, control=theirs.fileno())
            self._process = subprocess.Popen(  # noqa: S603 - our own program
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                env={**os.environ, **ENVIRONMENT},
            )
        assert self._process.stdin is not None
        with suppress(OSError), self._process.stdin as pipe:
            pickle.dump(setup, pipe)
        self.control.setblocking(False)

    def request(self, number: int, end: socket.socket) -> bool:
        """Have a worker forked that has this end of a connection; False if nobody is there."""
        try:
            socket.send_fds(self.control, [REQUEST.pack(number)], [end.fileno()])
        except OSError:
            self.is_ended = True
        return not self.is_ended

    def news(self) -> list[News]:
        """What it has told since the last call."""
        while not self.is_ended:
            try:
                data = self.control.recv(4096)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                data = b""
            self.is_ended = not data
            self._received += data
        whole = len(self._received) // NEWS.size * NEWS.size
        news = [News(*each) for each in NEWS.iter_unpack(self._received[:whole])]
        self._received = self._received[whole:]
        self.is_ready = self.is_ready or any(each.what == READY for each in news)
        return news

    @property
    def is_stopped(self) -> bool:
        """Whether somebody has stopped the process."""
        return is_stopped(self._process.pid)

    def kill(self) -> int:
        """End a process that hangs; returns its number. Its workers go on."""
        if self.is_ready:
            self._process.kill()
        else:
            os.killpg(self._process.pid, signal.SIGKILL)
        return self._process.pid

    def close(self) -> None:
        """End the process and its compiling helper. If it was killed, its workers may go on."""
        self.control.close()
        if self.is_ready:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ENDING_S)
        elif self._process.poll() is None:  # it does not listen yet
            os.killpg(self._process.pid, signal.SIGKILL)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
