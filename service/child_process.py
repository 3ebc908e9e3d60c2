"""What holds for processes that are started by ours."""

import ctypes
import signal
import sys

PR_SET_PDEATHSIG = 1  # from linux/prctl.h
# Opened here, so that a child between fork and exec loads nothing
_LIBRARY = ctypes.CDLL(None) if sys.platform.startswith("linux") else None


def end_with_parent(number: int = signal.SIGKILL) -> None:
    """Have this process end with the thread that has started it, whatever either is doing then."""
    if _LIBRARY is not None:
        _LIBRARY.prctl(PR_SET_PDEATHSIG, number)
