"""What holds for a process of ours: Python's settings, kernels loaded first, its end."""

import ctypes
import gc
import importlib
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from estimator.compilation.compiled import called_kernels, entry_point, is_compiled_code

# A thread that computes hands over Python's lock when another thread has waited for it this long.
# The usual 5 ms would make ticks late. With a much shorter time threads interrupt each other so
# often that, at 100 vehicles, a fifth of the time is lost.
SWITCH_INTERVAL_S = 5e-4
ADD_EVERY_S = 1.0
# With hundreds of vehicles one tick makes thousands of records, freed without the collector.
MANY_OBJECTS = 50_000


@contextmanager
def gc_settings() -> Iterator[Callable[[int, float], None]]:
    """While it lasts, the garbage collector ignores what existed before, and what is added.

    Half a million objects of libraries never become garbage. Looking through them takes 0.1 s,
    several ticks. Each vehicle brings a thousand objects that stay: the function that this yields
    adds them, at most once a second; it is given how many vehicles there are, and the time (s).
    """
    known, due_s = 0, 0.0

    def add(vehicles: int, now_s: float) -> None:
        nonlocal known, due_s
        if now_s < due_s:
            return
        due_s = now_s + ADD_EVERY_S
        if vehicles > known:
            gc.freeze()
        known = vehicles

    interval_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.set_threshold(MANY_OBJECTS, *thresholds[1:])
    gc.freeze()  # without collecting first, which takes as long and finds little
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield add
    finally:
        sys.setswitchinterval(interval_s)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


PR_SET_PDEATHSIG = 1  # from linux/prctl.h
MADV_DONTNEED = 4  # from asm-generic/mman-common.h
# Opened here, so that a child between fork and exec loads nothing
_LIBRARY = ctypes.CDLL(None) if sys.platform.startswith("linux") else None

ROOMS = ("estimator.live", "drivers.samples")
BLAS = "scipy.linalg.cython_blas"


def load_kernels() -> None:
    """Load what the service calls, so that no sample waits for it.

    For a process of the service's own: its kernels cannot use SciPy's linear algebra afterwards.
    """
    if not is_compiled_code():
        return
    _leave_out_scipy()
    for kernel in called_kernels():
        if kernel.py_func.__module__.startswith(ROOMS):
            entry_point(kernel)
            for overload in kernel.overloads.values():
                # 26 MB, with which only another kernel that calls it would be linked
                overload.library._shared_module = None  # noqa: SLF001 - numba has no other way
    if _LIBRARY is not None:
        with suppress(AttributeError, OSError):  # another C library, or no /proc
            _release_code(_LIBRARY, "libllvmlite.so")
            _LIBRARY.malloc_trim(0)  # 9 MB that loading has freed


def _release_code(system: ctypes.CDLL, library: str) -> None:
    """Give back the memory of a library's code, 50 MB of LLVM's; what still runs is read again."""
    for line in Path("/proc/self/maps").read_text(errors="replace").splitlines():
        span, access, *_ = line.split()
        if access == "r-xp" and line.endswith(library):
            begin, end = (int(bound, 16) for bound in span.split("-"))
            system.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), MADV_DONTNEED)


def _leave_out_scipy() -> None:
    """Have numba begin without SciPy's BLAS, which no kernel of ours uses.

    To load it takes as long as to load all kernels, and on a cold disk longer.
    """
    if BLAS in sys.modules:
        return
    sys.modules[BLAS] = None  # type: ignore[assignment] # importing it fails, and numba continues
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules[BLAS]


def end_with_parent() -> None:
    """Have this process end with the thread that has started it, whatever either is doing then."""
    if _LIBRARY is not None:
        _LIBRARY.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
