"""The one place that decides how kernels are compiled."""

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event
from numba.extending import register_jitable

from estimator.compilation.folder import kernel_folders, shipped_folder
from estimator.compilation.kernel_cache import KernelCache
from estimator.compilation.notice import compiling_begins

Function = TypeVar("Function", bound=Callable[..., Any])

_numba_config: Any = numba.config  # numba ships no types
_event: Any = event

# No branch at divisions. Inlining spares copying states of a hundred floats at each call, which
# halves the time of a step. No wrapper for C, as nothing calls a kernel from C.
_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "forceinline": True,
    "no_cfunc_wrapper": True,
}
OPTIONS = repr(_OPTIONS)  # as a part of the names of folders

NO_FOLDER = (
    "no writable folder for compiled code: compiling in memory at each start "
    "(set NUMBA_CACHE_DIR to a writable folder)"
)


def compiled(function: Function) -> Function:
    """Compile ``function`` with numba in nopython mode, cached on disk.

    Without a writable cache folder the function is compiled in memory at each
    start, and one warning says so. ``NUMBA_DISABLE_JIT=1`` leaves plain Python.
    ``error_model="numpy"`` keeps divisions free of branches: every division in
    the kernels is guarded by its own named threshold.
    """
    if _numba_config.DISABLE_JIT:
        return function
    dispatcher: Any = numba.njit(**_OPTIONS)(function)
    _kernels.add(id(dispatcher))
    if _FOLDERS or _SHIPPED:
        dispatcher._cache = KernelCache(dispatcher.py_func, _FOLDERS, _SHIPPED)  # noqa: SLF001
    return dispatcher  # type: ignore[no-any-return]


def inlined(function: Function) -> Function:
    """A part of compiled functions: compiled into each that calls it, plain Python elsewhere.

    It has no code that takes a hundred numbers over from Python and hands them back. That code
    would be half of what a kernel takes to compile.
    """
    return register_jitable(**_OPTIONS)(function)


def is_compiled_code() -> bool:
    """Whether there is any, and not plain Python alone."""
    return not _numba_config.DISABLE_JIT


def plain(function: Function) -> Function:
    """The Python function behind a compiled one; a single call is quicker without compiling."""
    return getattr(function, "py_func", function)


def is_cached(kernel: Any) -> bool | None:
    """Whether a compiled form of a kernel is there; None where none could be kept either."""
    holds = getattr(getattr(kernel, "_cache", None), "holds", None)
    if holds is None:
        return None
    return bool(holds(kernel.targetctx)) or (False if _FOLDERS else None)


_kernels: set[int] = set()  # ids of kernels, which stay unique: kernels are never deleted


class _Listener(_event.Listener):  # type: ignore[misc]
    """Is told of each function that numba compiles; those from the cache are not compiled."""

    def on_start(self, event: Any) -> None:
        """Say so if the function is one of our kernels."""
        if id(event.data["dispatcher"]) in _kernels:
            compiling_begins(is_kept=bool(_FOLDERS))

    def on_end(self, event: Any) -> None:
        """Do nothing: the end of compiling is not announced."""


_FOLDERS = () if _numba_config.DISABLE_JIT else kernel_folders(OPTIONS)
_SHIPPED = None if _numba_config.DISABLE_JIT else shipped_folder(OPTIONS)
if not _numba_config.DISABLE_JIT:
    _event.register("numba:compile", _Listener())
    if not _FOLDERS and _SHIPPED is None:
        warnings.warn(NO_FOLDER, RuntimeWarning, stacklevel=2)
