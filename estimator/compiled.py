"""The one place that decides how kernels are compiled."""

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_cache_usable = True


def compiled(function: Function) -> Function:
    """Compile ``function`` with numba in nopython mode, cached on disk.

    Without a writable cache folder the function is compiled in memory at each
    start, and one warning says so. ``NUMBA_DISABLE_JIT=1`` leaves plain Python.
    ``error_model="numpy"`` keeps divisions free of branches: every division in
    the kernels is guarded by its own named threshold.
    """
    return _decorate(function, parallel=False)


def compiled_parallel(function: Function) -> Function:
    """Like :func:`compiled`, with ``numba.prange`` spread over threads."""
    return _decorate(function, parallel=True)


def _decorate(function: Function, *, parallel: bool) -> Function:
    # States of a hundred floats pass by value: inlined they are not copied at
    # each call, which halves the time of a step.
    options: dict[str, Any] = {
        "error_model": "numpy",
        "parallel": parallel,
        "forceinline": not parallel,
    }
    global _cache_usable  # noqa: PLW0603 - one warning for the process, not one a function
    if _cache_usable:
        try:
            return numba.njit(cache=True, **options)(function)  # type: ignore[no-any-return]
        except RuntimeError as error:
            if "cache" not in str(error):
                raise
            _cache_usable = False
            warnings.warn(
                "no writable folder for compiled code: compiling in memory at each start "
                "(set NUMBA_CACHE_DIR to a writable folder)",
                RuntimeWarning,
                stacklevel=3,
            )
    return numba.njit(cache=False, **options)(function)  # type: ignore[no-any-return]
