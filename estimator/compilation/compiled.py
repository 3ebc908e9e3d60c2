"""The one place that decides how kernels are compiled."""

import functools
import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

# Kernels are made for any CPU of the architecture, so that those of a clone, a wheel and an image
# are the same; those of the host's own CPU are 3 % faster.
os.environ.setdefault("NUMBA_CPU_NAME", "generic")

from numba.core import caching, event
from numba.extending import register_jitable

import estimator.compilation.replace_fields  # noqa: F401 - kernels need it
from estimator.compilation.kernel_folder import (
    KernelFolder,
    KernelLocator,
    compiling_begins,
    sources_digest,
)

Function = TypeVar("Function", bound=Callable[..., Any])
Types = Callable[[], tuple[Any, ...]]  # numba's, of a call's arguments

_numba_config: Any = numba.config  # numba ships no types
_numba_config.reload_config()  # an earlier import of numba has read the variable before
_typeof: Any = numba.typeof
_caching: Any = caching
_event: Any = event

# No branch at divisions: every division in the kernels is guarded by its own named threshold.
# Inlining spares copying states of a hundred floats at each call, which halves the time of a step.
# No wrapper for C, as nothing calls a kernel from C.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "no_cfunc_wrapper": True}

# All kernels, and the types that commands call them with.
KERNELS: dict[Any, Types | None] = {}


def compiled(*, types: Types | None = None) -> Callable[[Function], Function]:
    """Compile a function with numba in nopython mode; kept on disk where that is possible.

    ``types`` are those of the arguments that commands call it with (:func:`types_of`), to compile
    ahead (:func:`entry_point`). ``NUMBA_DISABLE_JIT=1`` leaves plain Python.
    """

    def compiled_one(function: Any) -> Any:
        if _numba_config.DISABLE_JIT:
            return function
        dispatcher: Any = numba.njit(cache=_FOLDER.path is not None, **OPTIONS)(function)
        if not _FOLDER.is_writable:  # what is missing there is compiled in memory
            dispatcher._cache.save_overload = lambda *_: None  # noqa: SLF001 - no other way
        KERNELS[dispatcher] = types
        return dispatcher

    return compiled_one


def inlined(function: Function) -> Function:
    """A part of compiled functions: compiled into each caller, plain Python elsewhere.

    It needs no code that passes a hundred numbers between Python and numba, which would be half of
    the time of compiling a kernel.
    """
    return register_jitable(**OPTIONS)(function)


def shared(function: Function) -> Function:
    """A part of compiled functions that is large and called from several places of one."""
    return register_jitable(**{**OPTIONS, "forceinline": False})(function)


def is_compiled_code() -> bool:
    """Whether kernels are compiled, and not plain Python."""
    return not _numba_config.DISABLE_JIT


def plain(function: Function) -> Function:
    """The Python function behind a compiled one; a single call is quicker without compiling."""
    return getattr(function, "py_func", function)


def called_kernels() -> list[Any]:
    """The kernels of all imported modules that commands call."""
    return [kernel for kernel, types in KERNELS.items() if types is not None]


@functools.cache
def entry_point(kernel: Any) -> Callable[..., Any]:
    """The form of a kernel for the types that commands call it with; it checks no arguments.

    It is loaded from disk, or compiled if it is not there.

    numba's dispatcher looks up the types of the arguments at every call. For a handful of numbers
    and a handle that takes longer than a step of the filter. Without compiled code it is the Python
    function, whose results have Python's own numbers, too.
    """
    if _numba_config.DISABLE_JIT:
        return lambda *arguments: _plain_numbers(kernel(*arguments))
    types = KERNELS[kernel]
    assert types is not None
    return kernel.compile(types())  # type: ignore[no-any-return]


def _plain_numbers(value: Any) -> Any:
    """A result of plain Python with numpy's numbers as Python's own."""
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, tuple):
        return value
    kind, parts = type(value), map(_plain_numbers, value)
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


def types_of(*arguments: Any) -> tuple[Any, ...]:
    """What numba calls the types of these arguments."""
    return tuple(map(_typeof, arguments))


class _Listener(_event.Listener):  # type: ignore[misc]
    """Notices each function that numba compiles; those from the cache are not compiled."""

    def on_start(self, event: Any) -> None:
        """Notify if the function is one of our kernels."""
        if event.data["dispatcher"] in KERNELS:
            compiling_begins()

    def on_end(self, event: Any) -> None:
        """Do nothing: the end of compiling is not announced."""


if not _numba_config.DISABLE_JIT:
    _CPU = (str(_numba_config.CPU_NAME), str(_numba_config.CPU_FEATURES))
    _FOLDER = KernelLocator.folder = KernelFolder(sources_digest(repr(OPTIONS), *_CPU))
    _caching.CacheImpl._locator_classes.insert(0, KernelLocator)  # noqa: SLF001 - numba's only door
    _event.register("numba:compile", _Listener())
