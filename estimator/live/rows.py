"""Many samples, reports, and what is published about them, as rows of arrays.

Velocities wait as rows for the IMU sample behind them.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from estimator.aiding.types import NO_REPORT, Report
from estimator.compilation.compiled import inlined
from estimator.errors import InputError
from estimator.types import ZERO_VEC3, Bools, Floats, RateSample, Times, Vec3, VelocitySample

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


def report_row_of(row: int, report: VelocitySample | RateSample) -> Floats:
    """A report (REPORT_SIZE,) that comes before the sample of ``row``."""
    if isinstance(report, RateSample):
        return np.array((row, report.time_us, 1.0, *report.rate_rad_s, 0.0, 0.0, 0.0), np.float64)
    time_us, velocity, has_vertical, sigma_m_s, late_s = report
    return np.array((row, time_us, 0.0, *velocity, sigma_m_s, late_s, has_vertical), np.float64)


def report_rows_of(reports: Iterable[tuple[int, VelocitySample | RateSample]]) -> Floats:
    """Rows (M, REPORT_SIZE) of reports, each with the sample that it comes before, in order."""
    return np.array([report_row_of(*each) for each in reports]).reshape(-1, REPORT_SIZE)


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


@inlined
def is_due(report_rows: Floats, next_report: int, k: int) -> bool:
    """Whether there is a next report, and it comes before the sample of row ``k``."""
    return next_report < len(report_rows) and report_rows[next_report, ROW] <= k


# Reports come about as often as IMU samples do; of more than this the oldest go.
MOST_WAITING = 8


@inlined
def enqueue(waiting: Floats, row: Floats, most: int) -> Floats:
    """The waiting rows with a new one; of more than ``most`` the oldest goes."""
    kept = waiting[max(0, len(waiting) + 1 - most) :]
    longer = np.empty((len(kept) + 1, len(row)))
    longer[:-1] = kept
    longer[-1] = row
    return longer


@inlined
def take_due_velocities(
    waiting: Floats, time_us: int, oldest_s: float
) -> tuple[Floats, Report, Report]:
    """Those ahead of the IMU, and the latest of each source that it has reached by ``time_us``.

    A report waits for the first IMU sample that is not before it. Only the latest counts, as errors
    stay the same for a second or more. The two sources are a receiver, whose age is uncertain, and
    a filter; the one that began to wait first comes first.
    """
    one, other, one_is_late, any_yet = NO_REPORT, NO_REPORT, False, False
    for k in np.argsort(waiting[:, TIME], kind="mergesort"):  # in time, then as they came
        row = waiting[k]
        if row[TIME] <= time_us:
            is_late = row[LATE_S] > 0.0
            if not any_yet:
                one_is_late, any_yet = is_late, True
            if is_late == one_is_late:
                one = velocity_at(row, time_us, oldest_s)
            else:
                other = velocity_at(row, time_us, oldest_s)
    if not one.given:
        one, other = other, one
    return waiting[waiting[:, TIME] > time_us], one, other


@inlined
def velocity_at(row: Floats, time_us: int, oldest_s: float) -> Report:
    """A row as it is seen from the IMU sample of ``time_us``, if it is no older."""
    ago_s = 1e-6 * (time_us - int(row[TIME]))
    if ago_s > oldest_s:
        return NO_REPORT
    velocity = (row[X], row[Y], row[Z])
    return Report(True, velocity, row[HAS_VERTICAL] > 0.0, row[SIGMA_M_S], ago_s, row[LATE_S])
