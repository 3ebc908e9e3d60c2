"""Where workers come from: a process that has everything loaded and compiled, and forks.

A worker then begins within milliseconds, and shares the memory of libraries and compiled kernels
with the others. The process has no thread of its own, opens nothing and computes nothing, so that
there is nothing that a fork could break.
"""

import gc
import os
import pickle
import select
import signal
import socket
import sys
import time
from contextlib import suppress

from estimator.compilation.notice import tell_compiling
from estimator.errors import InputError
from service.offspring import end_with_parent
from service.warm_up import warm_up
from service.workers import worker
from service.workers.nursery_process import BORN, DEAD, NEWS, READY, REQUEST, Setup

GRACE_S = 1.5  # workers end by themselves when the service closes their connections
LOOK_S = 0.1


def serve(control_file: int) -> None:
    """Fork a worker for each request, until the service closes the control."""
    worker.ignore_signals()
    end_with_parent()  # even while it is stopped, and reads nothing that the service closes
    control = socket.socket(fileno=control_file)
    setup: Setup = pickle.load(sys.stdin.buffer)  # noqa: S301 - of the service itself
    tell_compiling(_say)
    try:
        warm_up(setup.profile, setup.gain)
    except InputError as error:
        _say(str(error))
        os._exit(1)
    gc.collect()
    gc.freeze()  # so that a worker's collector does not touch, and thereby copy, what is shared
    children = _Children(control)
    _tell(control, READY, os.getpid(), 0)
    while _is_open(control, children):
        children.reap()
    children.end()
    os._exit(0)


def _is_open(control: socket.socket, children: "_Children") -> bool:
    """Wait for a request and serve it; False at the end of the service."""
    if not select.select([control], [], [], LOOK_S)[0]:
        return True
    try:
        data, files, _, _ = socket.recv_fds(control, REQUEST.size, 1)
    except OSError:
        return False
    if len(data) < REQUEST.size or not files:
        return False
    (number,) = REQUEST.unpack(data)
    children.fork(number, files[0])
    return True


class _Children:
    """The workers that are alive."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._alive: set[int] = set()

    def fork(self, number: int, file: int) -> None:
        """Make a worker out of a copy of this process."""
        process = os.fork()
        if process == 0:
            self._control.close()
            worker.exit_status(socket.socket(fileno=file), number)
        os.close(file)
        self._alive.add(process)
        _tell(self._control, BORN, process, number)

    def reap(self) -> None:
        """Tell the service which workers have ended, and with which exit code."""
        for process in list(self._alive):
            ended, status = os.waitpid(process, os.WNOHANG)
            if ended:
                self._alive.discard(process)
                _tell(self._control, DEAD, process, os.waitstatus_to_exitcode(status))

    def end(self) -> None:
        """Wait for all; kill those that do not end in time."""
        end_s = time.monotonic() + GRACE_S
        while self._alive and time.monotonic() < end_s:
            self.reap()
            time.sleep(0.01)
        for process in self._alive:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        for process in self._alive:
            os.waitpid(process, 0)


def _tell(control: socket.socket, what: bytes, process: int, number: int) -> None:
    with suppress(OSError):  # the service is gone: there will be no further request
        control.send(NEWS.pack(what, process, number))


def _say(text: str) -> None:
    print(f"fuzzbee: {text}", file=sys.stderr, flush=True)
