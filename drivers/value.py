"""The base of immutable values that are made thousands of times a second."""

import msgspec


class Value(msgspec.Struct, frozen=True, gc=False):
    """Constant, comparable, hashable; made in 0.1 us, a tenth of a dataclass or named tuple.

    The garbage collector does not look inside: a value may hold numbers, texts, tuples and
    other values, but nothing that could lead back to it.
    """
