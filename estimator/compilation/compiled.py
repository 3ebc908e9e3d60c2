"""The one place that decides how kernels are compiled."""

import functools
import os
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.extending import register_jitable

from estimator.compilation.cache import kernel_cache_folder

Function = TypeVar("Function", bound=Callable[..., Any])

_numba_config: Any = numba.config  # numba ships no types

# Divisions without a branch. States of a hundred floats pass by value: inlined
# they are not copied at each call, which halves the time of a step. And nobody calls from C.
_DIVISION: dict[str, Any] = {"error_model": "numpy"}
_OPTIONS: dict[str, Any] = {**_DIVISION, "forceinline": True, "no_cfunc_wrapper": True}

# Our compiler stands on numba's inside: with a numba that it has not been tried with, or if
# told so, numba compiles as it always does, to the same results in twice the time.
TRIED_FROM, TRIED_BELOW = (0, 60), (0, 69)
PLAIN_NUMBA = "FUZZBEE_PLAIN_NUMBA"

NO_FOLDER = (
    "no writable folder for compiled code: compiling in memory at each start "
    "(set NUMBA_CACHE_DIR to a writable folder)"
)
NOT_KEPT = "compiled code cannot be kept for the next start"


def compiled(function: Function) -> Function:
    """Compile ``function`` with numba in nopython mode, cached on disk.

    Without a writable cache folder the function is compiled in memory at each
    start, and one warning says so. ``NUMBA_DISABLE_JIT=1`` leaves plain Python.
    ``error_model="numpy"`` keeps divisions free of branches: every division in
    the kernels is guarded by its own named threshold.
    """
    return _decorate(function, parallel=False)


def inlined(function: Function) -> Function:
    """A part of compiled functions: compiled into each that calls it, plain Python elsewhere.

    It saves the code that hands a hundred numbers over from Python and back,
    half of the time that a kernel takes to compile.
    """
    options = dict(_OPTIONS)
    if _has_own_compiler():
        from estimator.compilation.numba_compiler import PartCompiler

        options["pipeline_class"] = PartCompiler
    return register_jitable(**options)(function)


def plain(function: Function) -> Function:
    """The Python function behind a compiled one: for a single call it saves the compiling."""
    return getattr(function, "py_func", function)


def is_cached(name: str) -> bool | None:
    """Whether the kernel of that name lies in the cache; None where nothing is cached."""
    if _CACHE_FOLDER is None:
        return None
    return any(_CACHE_FOLDER.rglob(f"*.{name}-*.nbi"))


def compiled_parallel(function: Function) -> Function:
    """Like :func:`compiled`, with ``numba.prange`` spread over threads."""
    return _decorate(function, parallel=True)


def _decorate(function: Function, *, parallel: bool) -> Function:
    if _numba_config.DISABLE_JIT:
        return function
    dispatcher = _dispatcher(function, parallel=parallel)
    if _CACHE_FOLDER is None:
        return dispatcher  # type: ignore[no-any-return]
    # numba chooses the folder now; other users of numba keep theirs.
    folder_before = _numba_config.CACHE_DIR
    _numba_config.CACHE_DIR = str(_CACHE_FOLDER)
    try:
        dispatcher.enable_caching()
    finally:
        _numba_config.CACHE_DIR = folder_before
    _go_on_without_space(dispatcher)
    return dispatcher  # type: ignore[no-any-return]


def _dispatcher(function: Function, *, parallel: bool) -> Any:
    """What numba calls a compiled function."""
    if parallel:
        return numba.njit(**_DIVISION, parallel=True)(function)
    if not _has_own_compiler():
        return numba.njit(**_OPTIONS)(function)
    from estimator.compilation.numba_compiler import Kernel, KernelCompiler

    options = {**_OPTIONS, "nopython": True, "boundscheck": None}
    return Kernel(inlined(function), {}, options, KernelCompiler)


@functools.cache
def _has_own_compiler() -> bool:
    """Whether our compiler knows this numba."""
    major, minor = (int(part) for part in numba.__version__.split(".")[:2])
    return TRIED_FROM <= (major, minor) < TRIED_BELOW and not os.environ.get(PLAIN_NUMBA)


def _go_on_without_space(dispatcher: Any) -> None:
    """A disk too full for the cache costs the next start some seconds, not this one its life."""
    cache: Any = getattr(dispatcher, "_cache", None)
    save = getattr(cache, "save_overload", None)
    if save is None:  # not numba as we know it
        return

    def save_if_possible(signature: Any, data: Any) -> None:
        try:
            save(signature, data)
        except OSError as error:
            _warn_once(f"{NOT_KEPT}: {error.strerror}")

    cache.save_overload = save_if_possible


@functools.cache
def _warn_once(text: str) -> None:
    """numba forgets what has been warned of."""
    warnings.warn(text, RuntimeWarning, stacklevel=2)


_CACHE_FOLDER = None if _numba_config.DISABLE_JIT else kernel_cache_folder()
if _CACHE_FOLDER is None and not _numba_config.DISABLE_JIT:
    warnings.warn(NO_FOLDER, RuntimeWarning, stacklevel=2)
