"""Many samples and what is published about them, as rows of arrays."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Times
from estimator.compilation.compiled import inlined
from estimator.errors import InputError
from estimator.types import ZERO_VEC3, RateSample, Vec3, VelocitySample

# Columns of a row that shows an attitude: q_ned_frd, rate, bias, e, its rate, K, the confidences
# of gravity and field, the sigmas of inclination and heading, the place in ``NORTHS`` of what the
# heading is measured from, and 1 where velocity helps.
OUTPUT_SIZE = 19
Q, RATE, BIAS, SIGMA = slice(0, 4), slice(4, 7), slice(7, 10), slice(15, 17)
NORTH, AIDED = 17, 18
NORTHS = ("none", "magnetic", "true")
# Columns of a row that shows what others have measured: the sample that it comes before, its time
# (us), 1 for body rates and 0 for a velocity, three components, and of a velocity both sigmas and 1
# where the third component is known.
REPORT_SIZE = 9
ROW, TIME, IS_RATE, X, Y, Z, SIGMA_M_S, LATE_S, HAS_VERTICAL = range(REPORT_SIZE)
# What is done row by row is done with so many at a time: an hour's take too much room at once.
BLOCK = 100_000


class Rows(NamedTuple):
    """N samples, FRD. Arrays as compiled code takes them: C-contiguous.

    A field counts where ``has_mag`` is true; elsewhere its row may hold anything.
    """

    times_us: Times  # (N,)
    gyr_rad_s: Floats  # (N, 3)
    acc_m_s2: Floats  # (N, 3)
    mag_gauss: Floats  # (N, 3)
    has_mag: Bools  # (N,)


NO_SAMPLES = np.zeros((0, 3))
NO_ROWS = Rows(np.zeros(0, np.int64), NO_SAMPLES, NO_SAMPLES, NO_SAMPLES, np.zeros(0, np.bool_))
NO_OUTPUT = np.zeros((0, OUTPUT_SIZE))
NO_REPORT_ROWS = np.zeros((0, REPORT_SIZE))


def rows_of(
    times_us: Times, gyr_rad_s: Floats, acc_m_s2: Floats, mag_gauss: Floats, has_mag: Bools
) -> Rows:
    """The arrays as they are, or copies of those that are of another type or laid out otherwise.

    Raises:
        InputError: they do not hold N samples each, or no numbers.
    """
    n = len(times_us)
    return Rows(
        _plain(times_us, np.int64, (n,)),
        _plain(gyr_rad_s, np.float64, (n, 3)),
        _plain(acc_m_s2, np.float64, (n, 3)),
        _plain(mag_gauss, np.float64, (n, 3)),
        _plain(has_mag, np.bool_, (n,)),
    )


def _plain(values: Any, kind: type, shape: tuple[int, ...]) -> Any:
    try:
        plain: Any = np.asarray(values, kind, order="C")
    except (TypeError, ValueError):
        plain = None
    if plain is None or plain.shape != shape:
        msg = f"rows of samples take numbers of shape {shape}, not {np.shape(values)}"
        raise InputError(msg)
    return plain


def require_writable(published: Any, n: int) -> None:
    """Check that compiled code can write its output for n samples into an array.

    Raises:
        InputError: it is not C-contiguous float64 of shape (n, OUTPUT_SIZE), or read only.
    """
    is_plain = (
        isinstance(published, np.ndarray)
        and published.flags.carray
        and published.dtype == np.float64
    )
    if not is_plain or published.shape != (n, OUTPUT_SIZE):
        msg = f"attitudes of rows take a writable C-contiguous float64 array ({n}, {OUTPUT_SIZE})"
        raise InputError(msg)


def blocks(n: int) -> list[slice]:
    """The rows from 0 to n, ``BLOCK`` at a time."""
    return [slice(begin, min(begin + BLOCK, n)) for begin in range(0, n, BLOCK)]


@inlined
def reading_of(rows: Rows, k: int) -> tuple[int, Vec3, Vec3, Vec3, bool]:
    """One row: time, rate, specific force, field, and whether there is one; zero if not."""
    gyr, acc, mag = rows.gyr_rad_s, rows.acc_m_s2, rows.mag_gauss
    has_mag = rows.has_mag[k]
    field = (mag[k, 0], mag[k, 1], mag[k, 2]) if has_mag else ZERO_VEC3
    return (
        rows.times_us[k],
        (gyr[k, 0], gyr[k, 1], gyr[k, 2]),
        (acc[k, 0], acc[k, 1], acc[k, 2]),
        field,
        has_mag,
    )


def cut(rows: Rows, begin: int, end: int | None = None, every: int = 1) -> Rows:
    """The rows from ``begin`` up to ``end``, or one in so many of them."""
    return Rows._make(column[begin:end:every] for column in rows)


def report_rows_of(reports: Iterable[tuple[int, VelocitySample | RateSample]]) -> Floats:
    """Rows (M, REPORT_SIZE) of reports, each with the sample that it comes before, in order."""
    report_rows: list[tuple[float, ...]] = []
    for row, report in reports:
        if isinstance(report, RateSample):
            report_rows.append((row, report.time_us, 1.0, *report.rate_rad_s, 0.0, 0.0, 0.0))
        else:
            time_us, velocity, has_vertical, sigma_m_s, late_s = report
            report_rows.append((row, time_us, 0.0, *velocity, sigma_m_s, late_s, has_vertical))
    return np.array(report_rows, np.float64).reshape(-1, REPORT_SIZE)


def report_of(row: Floats) -> VelocitySample | RateSample:
    """What one row (REPORT_SIZE,) shows."""
    _, time_us, is_rate, x, y, z, sigma_m_s, late_s, has_vertical = row.tolist()
    if is_rate:
        return RateSample(int(time_us), (x, y, z))
    return VelocitySample(int(time_us), (x, y, z), bool(has_vertical), sigma_m_s, late_s)


def reports_between(report_rows: Floats, begin: int, end: int) -> Floats:
    """What comes before the rows from ``begin`` up to ``end``, counted from there."""
    first, behind = np.searchsorted(report_rows[:, ROW], (begin, end))
    part = report_rows[first:behind].copy()
    part[:, ROW] -= begin
    return part
