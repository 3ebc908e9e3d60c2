"""Kernels as plain Python, for as long as their compiled form is not there.

A first start would otherwise stand still for a minute or more. The code is the same, and so are
its results: a kernel is copied with all functions of ours that it uses, each in its Python form.
"""

from collections.abc import Callable
from contextvars import ContextVar
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from estimator.compilation.compiled import plain
from estimator.compilation.fingerprint import is_library, names_of

_forms: dict[int, tuple[Any, Any]] = {}  # by id, with the function itself, which keeps its id


def interpreted(value: Any) -> Any:
    """A function in Python, with all that it calls; another value as it is.

    What compiled code sees as something else than Python does names that as its ``in_python``.
    """
    value = plain(getattr(value, "in_python", value))
    if not isinstance(value, FunctionType) or is_library(value):
        return value
    if id(value) not in _forms:
        used: dict[str, Any] = {"__builtins__": value.__globals__["__builtins__"]}
        cells = tuple(
            type(cell)(interpreted(cell.cell_contents)) for cell in value.__closure__ or ()
        )
        form = FunctionType(value.__code__, used, value.__name__, value.__defaults__, cells)
        form.__kwdefaults__ = value.__kwdefaults__
        _forms[id(value)] = (value, form)  # before its own globals: it may use itself
        names = set(names_of(value.__code__))
        for name in names & value.__globals__.keys():
            used[name] = _seen_by(value.__globals__[name], names)
    return _forms[id(value)][1]


def _seen_by(value: Any, names: set[str]) -> Any:
    """A global as a function sees it that uses ``names``: of a module of ours, what they mean."""
    if not isinstance(value, ModuleType) or is_library(value):
        return interpreted(value)
    inside = names & vars(value).keys()
    return SimpleNamespace(**{name: interpreted(vars(value)[name]) for name in inside})


def in_plain_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with numpy's numbers in its results as Python's own, as compiled code has them.

    They come from arrays.
    """
    return lambda *arguments: _plain(function(*arguments))


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, tuple):
        return value
    kind, parts = type(value), map(_plain, value)
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


# Whether kernels are interpreted now; each thread has its own answer.
_is_interpreting: ContextVar[bool] = ContextVar("is_interpreting", default=False)


def set_interpreting(is_interpreting: bool) -> None:
    """Have kernels interpreted or called as compiled, in this thread, from the next core on."""
    _is_interpreting.set(is_interpreting)


def is_interpreting() -> bool:
    """Whether kernels are interpreted now, in this thread."""
    return _is_interpreting.get()
