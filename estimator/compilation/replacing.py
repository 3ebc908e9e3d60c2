"""Some fields of a named tuple replaced, in compiled code and in plain Python alike.

numba does not know ``NamedTuple._replace``, so that compiled code would have to name every field
of a new value. What is made here names them once, from the type.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from estimator.compilation.compiled import inlined

Value = TypeVar("Value", bound=NamedTuple)


def replacer(kind: type[Value], *names: str) -> Callable[..., Value]:
    """A function of a ``kind`` and new values of the fields ``names``, which returns the new one.

    ``replacer(State, "bias", "age_s")(state, bias, age_s)`` is ``state._replace(bias=bias,
    age_s=age_s)``, and inside a compiled function the same machine code as naming all fields.

    Raises:
        ValueError: ``kind`` has no such field, or it is named twice.
    """
    fields: tuple[str, ...] = kind._fields
    strangers = [name for name in names if name not in fields]
    if strangers or len(set(names)) < len(names):
        raise ValueError(f"{kind.__name__} has the fields {fields}, once each, not {names}")
    values = ", ".join(name if name in names else f"before.{name}" for name in fields)
    source = f"def replace(before, {', '.join(names)}): return kind({values})"
    made: dict[str, Any] = {"kind": kind, "__name__": __name__}
    exec(source, made)  # noqa: S102 - the text is made of a type's field names
    return inlined(made["replace"])  # type: ignore[no-any-return]
