"""Bounds of the parameters, declared by their types, which every estimator survives.

They are far wider than any useful value, and narrow enough that squares, quotients and exponentials
stay within floating point numbers. Tests run an estimator with every parameter at both ends.
"""

from collections.abc import Mapping
from functools import cache
from math import pi, radians
from typing import Annotated, Any, get_args, get_type_hints

from msgspec import Meta

from estimator.errors import InputError

# Nothing is divided by less, in its own unit: a share, s, (m/s^2)^2. Rounding is within it.
TINY = 1e-6

Time = Annotated[float, Meta(ge=1e-3, le=1e4)]  # s
Lag = Annotated[float, Meta(ge=1e-4, le=1.0)]  # s
Angle = Annotated[float, Meta(ge=radians(1e-3), le=pi)]  # rad
Rate = Annotated[float, Meta(ge=1e-6, le=10.0)]  # rad/s
Acceleration = Annotated[float, Meta(ge=1e-4, le=1e3)]  # m/s^2
Speed = Annotated[float, Meta(ge=1e-3, le=1e3)]  # m/s
Field = Annotated[float, Meta(ge=1e-5, le=10.0)]  # gauss
Noise = Annotated[float, Meta(ge=1e-6, le=10.0)]  # a density, in its parameter's own unit
Share = Annotated[float, Meta(ge=1e-2, le=100.0)]  # a ratio


@cache
def bounds_of(kind: type) -> Mapping[str, tuple[Any, Any]]:
    """The bounds of a parameter type's numbers, both included, by name."""
    hints = get_type_hints(kind, include_extras=True).items()
    marks = [(name, mark) for name, hint in hints for mark in get_args(hint)]
    return {name: (mark.ge, mark.le) for name, mark in marks if isinstance(mark, Meta)}


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
