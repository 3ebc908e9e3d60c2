"""What a compiled function is made of, as a digest.

numba itself compiles a function anew when the file that holds it changes: after a change of a
comment, too, but not after one of a constant or a type in another file. Here a function is
described by what ends up in machine code: its instructions and constants, the functions,
constants and types that it uses, and so on through all of them. Docstrings, comments and line
numbers are no part of it.
"""

import hashlib
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Annotated, Any, get_args, get_origin

# What is inside these is not looked at: each of their versions has a cache folder of its own.
LIBRARIES = ("builtins", "numba", "numpy", "math", "llvmlite", "typing")
DIGITS = 16


class Fingerprints:
    """Digests of functions. One instance looks at each thing once, which later kernels share."""

    def __init__(self) -> None:
        # by id, with the thing itself: while that is kept, no other gets the same id
        self._known: dict[int, tuple[Any, str]] = {}

    def of(self, function: FunctionType) -> str:
        """A digest of the function and of all that it uses; its module must be complete."""
        return _digest(self._describe(function))

    def _describe(self, value: Any) -> str:
        """A value and what it is made of, as text."""
        value = getattr(value, "py_func", value)  # behind a compiled function
        if isinstance(value, bool | int | str | bytes | None):
            return repr(value)
        if isinstance(value, float):
            return value.hex()
        if isinstance(value, frozenset):
            value = tuple(sorted(value, key=repr))
        if isinstance(value, tuple | list):
            return f"{_name(type(value))}({', '.join(map(self._describe, value))})"
        if isinstance(value, ModuleType) or is_library(value):
            return f"library {_name(value)}"
        if isinstance(value, FunctionType | type) and not get_args(value):
            return self._describe_once(value)
        if isinstance(value, CodeType):
            return self._code(value, None)
        if get_origin(value) is Annotated:
            return self._describe(get_args(value)[0])  # bounds play no part in a kernel
        if get_args(value):
            return f"{get_origin(value)}{self._describe(get_args(value))}"
        if hasattr(value, "tobytes"):  # an array
            return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
        return f"a {_name(type(value))}"

    def _describe_once(self, value: Any) -> str:
        if id(value) not in self._known:
            self._known[id(value)] = (value, "itself")  # ends the recursion if it uses itself
            text = self._function(value) if isinstance(value, FunctionType) else self._type(value)
            self._known[id(value)] = (value, f"{_name(value)} {_digest(text)}")
        return self._known[id(value)][1]

    def _function(self, function: FunctionType) -> str:
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        defaults = (function.__defaults__, tuple((function.__kwdefaults__ or {}).items()))
        parts = [self._describe((cells, defaults, tuple(function.__annotations__.items())))]
        parts.append(self._code(function.__code__, function.__doc__))
        names = sorted(set(names_of(function.__code__)))
        parts += [
            f"{name} = {self._describe(value)}"
            for name in names
            if name in function.__globals__
            for value in _used_values(function.__globals__[name], names)
        ]
        return "\n".join(parts)

    def _code(self, code: CodeType, docstring: str | None) -> str:
        first, *others = code.co_consts or (None,)
        constants = (None if first == docstring else first, *others)
        names = (code.co_varnames, code.co_names, code.co_freevars, code.co_flags)
        return self._describe((names, code.co_code, code.co_exceptiontable, constants))

    def _type(self, kind: type) -> str:
        """A named tuple's fields in their order; of another class its name."""
        fields = tuple(getattr(kind, "__annotations__", {}).items())
        return self._describe((fields, tuple(getattr(kind, "_field_defaults", {}).items())))


def _used_values(value: Any, names: list[str]) -> list[Any]:
    """A global's value; of a module of ours also those of its values that ``names`` may mean."""
    if not isinstance(value, ModuleType) or is_library(value):
        return [value]
    return [value, *(vars(value)[name] for name in names if name in vars(value))]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:DIGITS]


def names_of(code: CodeType) -> Iterator[str]:
    """All names that a code looks up, also inside functions within it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from names_of(constant)


def _name(value: Any) -> str:
    module = getattr(value, "__module__", None)
    return f"{module}.{getattr(value, '__qualname__', getattr(value, '__name__', ''))}"


def is_library(value: Any) -> bool:
    """Whether something is a library's, and not ours."""
    module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    is_generic = bool(get_args(value))  # tuple[Vec3, ...]: what is inside may be ours
    return not is_generic and str(module).partition(".")[0] in LIBRARIES
