"""Compiled code called with arguments whose types are known: nobody looks at them at each call.

numba's dispatcher finds out at every call which types it has been given. For a handful of numbers
and a handle on compiled memory that takes longer than a step of the filter.
"""

import functools
from collections.abc import Callable
from typing import Any

import numba

_typeof: Any = numba.typeof  # numba ships no types


@functools.cache
def direct(kernel: Any, types: tuple[Any, ...]) -> Callable[..., Any]:
    """The form of a kernel that takes arguments of these types (numba's), and checks no more.

    It is compiled now, unless that has been done; to ask numba for it takes 20 us even then.
    Without compiled code it is the Python function.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return kernel  # type: ignore[no-any-return]
    return kernel.compile(types)  # type: ignore[no-any-return]


def types_of(*arguments: Any) -> tuple[Any, ...]:
    """What numba calls the types of these arguments."""
    return tuple(map(_typeof, arguments))
