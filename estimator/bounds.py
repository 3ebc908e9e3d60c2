"""Bounds of the parameters, declared by their types, which every estimator survives.

They are far wider than any useful value, and narrow enough that squares, quotients and exponentials
stay within floating point numbers. Tests run an estimator with every parameter at both ends.
"""

from collections.abc import Mapping
from functools import cache
from math import pi, radians
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

from estimator.errors import InputError

# Nothing is divided by less, in its own unit: a share, s, (m/s^2)^2. Rounding is within it.
TINY = 1e-6


class Within(NamedTuple):
    """A number from ``low`` to ``high``, both included."""

    low: float
    high: float


Time = Annotated[float, Within(1e-3, 1e4)]  # s
Lag = Annotated[float, Within(1e-4, 1.0)]  # s
Angle = Annotated[float, Within(radians(1e-3), pi)]  # rad
Rate = Annotated[float, Within(1e-6, 10.0)]  # rad/s
Acceleration = Annotated[float, Within(1e-4, 1e3)]  # m/s^2
Speed = Annotated[float, Within(1e-3, 1e3)]  # m/s
Field = Annotated[float, Within(1e-5, 10.0)]  # gauss
Noise = Annotated[float, Within(1e-6, 10.0)]  # a density, in its parameter's own unit
Share = Annotated[float, Within(1e-2, 100.0)]  # a ratio


@cache
def bounds_of(kind: type) -> Mapping[str, Within]:
    """The bounds of a parameter type's numbers, by name."""
    found: dict[str, Within] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        marks = [mark for mark in get_args(hint) if isinstance(mark, Within)]
        if marks:
            found[name] = marks[0]
    return found


def require_within(section: str, values: Mapping[str, Any], kind: type) -> None:
    """Check numbers against the bounds that ``kind`` declares.

    Raises:
        InputError: names the first one that is outside, and its bounds.
    """
    for name, (low, high) in bounds_of(kind).items():
        if name in values and not low <= values[name] <= high:
            raise InputError(
                f"{section}.{name}: {values[name]:g} is outside [{low:.4g}, {high:.4g}]"
            )
