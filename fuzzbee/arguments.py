"""What programs give, checked: three numbers, rows of three, times."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.types import Vec3

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

MICROSECONDS = 1e6
# Microseconds fit into 64 bits up to here, 285 000 years.
MOST_S = 9e12


def vector(name: str, given: ArrayLike) -> Vec3:
    """Three numbers, not necessarily finite.

    Raises:
        InputError: it has not three numbers.
    """
    values: Any = given.tolist() if isinstance(given, np.ndarray) else given
    try:
        x, y, z = values
        if type(x) is type(y) is type(z) is float:  # as nearly always
            return (x, y, z)
        return (float(x), float(y), float(z))
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be three numbers, not {given!r:.60}") from None


def matrix(name: str, given: ArrayLike, rows: int | None = None) -> Floats:
    """(N, 3) numbers.

    Raises:
        InputError: another shape, or something else than numbers.
    """
    try:
        values = np.asarray(given, dtype=float, order="C")
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be an array of numbers") from None
    if values.ndim != 2 or values.shape[1] != 3 or rows not in (None, len(values)):
        wanted = "N" if rows is None else rows
        raise InputError(f"{name}: must have the shape ({wanted}, 3), not {values.shape}")
    return values


def microseconds(time_s: float) -> int:
    """A time as the estimator counts it.

    Raises:
        InputError: it is not a number of seconds.
    """
    if not abs(time_s) < MOST_S:
        raise InputError(f"time_s {time_s}: must be a number of seconds")
    return round(MICROSECONDS * time_s)


def microseconds_of_rows(given: ArrayLike, rows: int) -> Times:
    """Times (N,) of so many rows, in microseconds.

    Raises:
        InputError: another shape, or something else than numbers of seconds.
    """
    values = np.asarray(given, dtype=float)
    if values.shape != (rows,):
        raise InputError(f"time_s: must have the shape ({rows},), not {values.shape}")
    wrong = values[~(np.abs(values) < MOST_S)]
    if wrong.size:
        raise InputError(f"time_s {wrong[0]}: must be a number of seconds")
    return np.rint(MICROSECONDS * values).astype(np.int64)
