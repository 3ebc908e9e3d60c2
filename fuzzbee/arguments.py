"""What programs give, checked: numbers, vectors, rows; an InputError names what is none."""

from math import inf, nan
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray  # `vector` runs three times a sample; np.ndarray costs 30 ns more each
from numpy.typing import ArrayLike

from estimator.aiding.sources.source import SPEED_LIMIT_M_S
from estimator.errors import InputError
from estimator.live.rows import HAS_VERTICAL, REPORT_SIZE, ROW, SIGMA_M_S, TIME, X, Z
from estimator.profile import LEAST_GAIN, MOST_GAIN, Profile, load_profile
from estimator.types import Floats, Times, Vec3

MICROSECONDS = 1e6
MOST_S = 9e12  # 285 000 years: microseconds fit into 64 bits up to here
VELOCITY_SIGMA_M_S = 0.3  # of a satellite receiver's or an autopilot's velocity
MOST_PLACE = (90.0, 360.0, inf, MOST_S)  # latitude, longitude (deg), altitude (m), Unix time (s)


def number(name: str, given: Any, low: float = -inf, high: float = inf, of: str = "") -> float:
    """A finite number from ``low`` to ``high``; ``of`` is what it counts."""
    try:
        value = nan if isinstance(given, str | bytes | bool) else float(given)
    except (TypeError, ValueError, OverflowError):
        value = nan
    if not (low <= value <= high and abs(value) < inf):
        within = (
            "" if low == -inf else f", {low:g} or more" if high == inf else f", {low:g} to {high:g}"
        )
        raise InputError(f"{name} {given!s:.60}: must be a number{of}{within}")
    return value


def gain_of(name: str, given: Any) -> float:
    """A gain K within the limits of the filter."""
    return number(name, given, LEAST_GAIN, MOST_GAIN)


def vector(name: str, given: ArrayLike) -> Vec3:
    """Three numbers, not necessarily finite."""
    values: Any = given.tolist() if isinstance(given, ndarray) else given
    try:
        x, y, z = values
        if type(x) is type(y) is type(z) is float:  # as nearly always
            return (x, y, z)
        if not isinstance(values, bytes | str | set | dict):
            return (float(x), float(y), float(z))
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name}: must be three numbers, not {' '.join(repr(given).split()):.60}")


def rotation(name: str, given: ArrayLike) -> Floats:
    """A rotation matrix (3, 3)."""
    R = array(name, given, 3, 3)
    if not (np.abs(R.T @ R - np.eye(3)).max() < 1e-6 and np.linalg.det(R) > 0.0):
        raise InputError(f"{name}: must be a rotation matrix")
    return R


def file(name: str, given: Any) -> Path:
    """The path of a file."""
    if not isinstance(given, str | PathLike):
        raise InputError(f"{name} {given!s:.60}: must be the name of a file")
    return Path(given)


def profile_of(given: Any) -> Profile:
    """A profile, or the one of this name or file."""
    if isinstance(given, int | float):
        raise InputError(f"profile {given}: must be a name or a file (a rate is rate_hz={given})")
    return given if isinstance(given, Profile) else load_profile(given)


def microseconds(time_s: float) -> int:
    """A time as the estimator counts it."""
    return round(MICROSECONDS * number("time_s", time_s, -MOST_S, MOST_S, " of seconds"))


def times_of(given: ArrayLike, rows: int) -> Times:
    """Times (N,) of so many rows, in microseconds."""
    values = array("time_s", given, rows)
    wrong = values[~(np.abs(values) < MOST_S)]
    if wrong.size:
        raise InputError(f"time_s {wrong[0]}: must be a number of seconds")
    return np.rint(MICROSECONDS * values).astype(np.int64)


def array(name: str, given: ArrayLike, *shape: int | None) -> Floats:
    """Numbers, NaN where one is masked, of this shape if there is one; None is any length."""
    try:
        found: Any = given if isinstance(given, ndarray) else np.ma.asarray(given)
        if found.dtype.kind not in "biufO":
            raise TypeError  # noqa: TRY301 - numbers as text, complex ones and dates are none
        values: Floats = np.asarray(np.ma.filled(found.astype(float), nan), order="C")
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: must be an array of numbers") from None
    sizes = zip(shape, values.shape, strict=False)
    if shape and (len(shape) != values.ndim or any(n not in (None, size) for n, size in sizes)):
        wanted = str(shape).replace("None", "N")
        raise InputError(f"{name}: must have the shape {wanted}, not {values.shape}")
    return values


def velocities_of(times_us: Times, velocity: Floats) -> tuple[Floats, int]:
    """Reports (M, REPORT_SIZE) of velocities (N, 3); how many are too fast and left out.

    NaN is unknown; only the third component may be unknown in a report.
    """
    known = np.flatnonzero(np.isfinite(velocity[:, :2]).all(axis=1))
    reports = np.zeros((len(known), REPORT_SIZE))
    reports[:, ROW], reports[:, TIME] = known, times_us[known]
    reports[:, X : Z + 1], reports[:, SIGMA_M_S] = velocity[known], VELOCITY_SIGMA_M_S
    reports[:, HAS_VERTICAL] = np.isfinite(reports[:, Z])
    reports[reports[:, HAS_VERTICAL] == 0.0, Z] = 0.0
    is_fast = np.abs(reports[:, X : Z + 1]).max(axis=1, initial=0.0) > SPEED_LIMIT_M_S
    return reports[~is_fast], int(is_fast.sum())


def positions_of(position: ArrayLike, n: int) -> Floats:
    """The rows (K, 5) of positions (N, 4) that are known, behind their numbers."""
    places = array("position", position, n, 4)
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    wrong = known[(np.abs(places[known]) > MOST_PLACE).any(axis=1)]
    if len(wrong):
        place = places[wrong[0]].tolist()
        raise InputError(f"position {place}: no place on Earth, or no time")
    return np.column_stack((known, places[known]))
