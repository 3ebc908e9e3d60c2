"""The kernels of the live service, loaded before its first sample (or compiled, where none are)."""

import ctypes
import importlib
import sys
from contextlib import suppress

from estimator.compilation.compiled import build, called_kernels, is_compiled_code

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
            build(kernel)
    with suppress(AttributeError, OSError, TypeError):  # only the GNU C library has to be told
        ctypes.CDLL(None).malloc_trim(0)  # 9 MB that loading has freed


def _leave_out_scipy() -> None:
    """Have numba begin without SciPy's BLAS, which no kernel of ours uses.

    To load it takes as long as to load all kernels, and on a cold disk longer.
    """
    if BLAS in sys.modules:
        return
    sys.modules[BLAS] = None  # type: ignore[assignment] # to import it fails, and numba goes on
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules[BLAS]
