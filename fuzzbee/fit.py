"""Whether a recording's units and axes fit each other, and which would fit better.

The gyroscope is compared with how the specific force, and the magnetic field without its
hard iron, turn from each twentieth of a second to the next, in every unit and with every axis and
sign that data usually come in.
"""

from collections.abc import Iterator
from itertools import product
from math import pi

import numpy as np

from estimator.live.rows import Rows
from estimator.types import Floats, Times
from tuning.turning import (
    MOST,
    SIZED,
    SLOW_S,
    TURNS,
    median,
    roots,
    spans_of,
    squares_left,
    usual_of,
)

LEAST_S = 5.0  # shorter recordings show too little
SLOWEST_S = 2.0  # between samples: what is slower has another unit
# Another way is reported if it leaves half as much, and the turning explains a third of the change.
BETTER = 2.0
EXPLAINED = 2.0 / 3.0
# Beside accelerations nothing is explained, but a unit that is too large makes it so much worse.
MUCH_BETTER = 8.0
ALIKE = 1.05  # of two ways that leave as much the plainer one is reported
UPSIDE_DOWN_LINE = (
    "the vehicle is upside down most of the time: data in x forward, y left, z up want"
    " * (1, -1, -1) for all three, gravity instead of specific force wants acc * -1"
)

# Medians that the units have: an IMU in g has 1, the Earth's field is 0.22 to 0.67 gauss.
Units = tuple[tuple[float, float, str], ...]
ACC_UNITS: Units = (
    (0.5, 2.0, "acc * 9.80665 (g)"),
    (28.0, 38.0, "acc * 0.3048 (feet)"),
    (500.0, 2e3, "acc * 9.80665e-3 (mg)"),
)
MAG_UNITS: Units = (
    (1.5e-5, 1e-4, "mag * 1e4 (tesla)"),
    (15.0, 100.0, "mag / 100 (microtesla)"),
    (150.0, 1e3, "mag / 1000 (milligauss)"),
    (1.5e4, 1e5, "mag / 1e5 (nanotesla)"),
)
GYR_UNITS = ((1.0, ""), (pi / 180.0, " * pi / 180"))
# What an accelerometer reads mostly, on the hardest flight; a field with any iron, normalised, too.
ACC_USUAL = (4.9, 19.6)
MAG_USUAL = (0.05, 5.0)
ALMOST_G = (8.5, 11.0)  # m/s^2
# Between samples: what is quicker has another unit than seconds. From each on, time_s is in this.
FASTEST_S = 3e-5
TIME_UNITS = ((6e5, "nanoseconds", 1e9), (600.0, "microseconds", 1e6), (0.0, "milliseconds", 1e3))


def as_written(name: str, turn: Floats, unit: str = "") -> str:
    """Readings by a signed permutation of axes (3, 3), and in a unit, as a program writes it."""
    order = np.argmax(np.abs(turn), axis=1).tolist()
    signs = tuple(round(float(turn[k, place])) for k, place in enumerate(order))
    axes = "" if order == [0, 1, 2] else f"[:, {order}]"
    return f"{name}{axes}{'' if signs == (1, 1, 1) else f' * {signs}'}{unit}"


@np.errstate(all="ignore")  # of numbers that are no readings
def advice(rows: Rows) -> tuple[str, ...]:
    """Lines for a person, each with what would fit better; none of a recording that is sound."""
    times_us = rows.times_us
    step_s, acc_size, mag_size, is_upside_down = usual_of(rows)
    if len(times_us) > SIZED and 0.0 < step_s < FASTEST_S:
        return (f"samples are {step_s:.1g} s apart: time_s counts seconds",)
    if not is_enough(times_us):
        return ()
    if step_s < 0.0:
        return ("time_s runs backwards: [::-1] of all arrays would turn it round",)
    found, shrunk = _times(rows, step_s)
    if shrunk < 1.0:
        rows = _shrunk(rows, shrunk)
    if not rows.gyr_rad_s.any():
        found.append("the gyroscope reads nothing but 0")
    found += [*_swapped(rows, acc_size, mag_size)] or [
        *_unit("accelerometer", acc_size, ACC_UNITS, ACC_USUAL),
        *(_unit("magnetometer", mag_size, MAG_UNITS, MAG_USUAL) if rows.has_mag.any() else ()),
        *_axes(rows),
        *((UPSIDE_DOWN_LINE,) if is_upside_down else ()),
    ]
    return tuple(found)


def is_enough(times_us: Times) -> bool:
    """Whether a recording is long enough to be judged."""
    return len(times_us) > 2 and 1e-6 * abs(int(times_us[-1] - times_us[0])) >= LEAST_S


def _times(rows: Rows, step_s: float) -> tuple[list[str], float]:
    """A line about the times, and the factor that makes them fit."""
    if step_s <= SLOW_S:
        return [], 1.0
    unit, divisor = next(each[1:] for each in TIME_UNITS if step_s > each[0])
    true_s = _true_step_s(rows, step_s)
    apart, shrunk = f"samples are {step_s:.3g} s apart", min(1.0, true_s / step_s)
    if step_s > SLOWEST_S or BETTER > true_s * divisor / step_s > 1.0 / BETTER:
        return [f"{apart}: {unit} want time_s / {divisor:g}"], shrunk
    if BETTER * true_s < step_s:
        return [f"{apart} and turn as if {true_s:.2g} s were between"], shrunk
    return [], 1.0


def _shrunk(rows: Rows, factor: float) -> Rows:
    return rows._replace(times_us=np.rint(rows.times_us * factor).astype(np.int64))


def _true_step_s(rows: Rows, step_s: float) -> float:
    """The time between samples by how vectors turn; that given, if they do not show."""
    best, true_s = EXPLAINED, step_s
    for tried_s, is_field in product((0.001, 0.004, 0.016), (True, False)):
        spans, _ = spans_of(_shrunk(rows, tried_s / step_s), is_field)
        squares = squares_left(spans, TURNS[:1], has_offset=False)
        scale = _best_scale(squares)
        share = float(roots(squares, scale)[0, 0])
        if scale > 0.0 and share <= best:
            best, true_s = share, tried_s * scale
    return true_s


def _best_scale(squares: Floats) -> float:
    """What the first way's angles times which number leave least."""
    _, (linear, square) = squares[0].tolist()
    return float(-linear / square) if square > 0.0 else 0.0


def _unit(what: str, size: float, units: Units, usual: tuple[float, float]) -> Iterator[str]:
    reads = f"the {what} reads {size:.3g} mostly"
    if better := [unit for low, high, unit in units if low <= size <= high]:
        yield f"{reads}, which would fit as {better[0]}"
    elif not usual[0] <= size <= usual[1]:
        yield f"{reads}, {usual[0]:g} to {usual[1]:g} is usual"


def _swapped(rows: Rows, acc_size: float, mag_size: float) -> Iterator[str]:
    """Whether another sensor reads what the accelerometer should; one that turns so fast varies."""
    if ACC_USUAL[0] <= acc_size <= ACC_USUAL[1]:
        return
    rates = np.linalg.norm(rows.gyr_rad_s[:: max(1, len(rows.gyr_rad_s) // SIZED)], axis=1)
    steady = np.count_nonzero((rates >= ALMOST_G[0]) & (rates <= ALMOST_G[1]))
    swapped = "{} reads {:.3g} mostly, as acc should: they may be swapped"
    if steady > EXPLAINED * len(rates):
        yield swapped.format("gyr", median(rates[rates < MOST]))
    if ACC_USUAL[0] <= mag_size <= ACC_USUAL[1] and MAG_USUAL[0] <= acc_size <= MAG_USUAL[1]:
        yield swapped.format("mag", mag_size)


def _axes(rows: Rows) -> Iterator[str]:
    """What the turning of field and force shows of the gyroscope, or of the field's axes."""
    for what, is_field in (("magnetometer", True), ("accelerometer", False)):
        spans, share = spans_of(rows, is_field)
        # a cheap look first: other ways are tried only where much is left
        if share > EXPLAINED and (better := _better(spans, is_field=is_field)):
            yield f"gyroscope and {what} agree {better}"
            return


def _better(spans: Floats, *, is_field: bool) -> str | None:
    """How many times less which other way leaves; None if no way is so much better."""
    squares = squares_left(spans, TURNS, has_offset=is_field)
    scale = _best_scale(squares)
    left = roots(squares, *(factor for factor, _ in GYR_UNITS), scale)
    as_given, scaled, least = float(left[0, 0]), float(left[-1, 0]), float(left[:-1].min())
    if as_given <= EXPLAINED:
        return None
    of_units, of_turns = divmod(int(np.argmax(left[:-1] <= ALIKE * least)), len(TURNS))
    (unit_scale, unit), turn = GYR_UNITS[of_units], TURNS[of_turns]
    is_other = max(scale, 1.0 / max(scale, 1e-9)) > BETTER and scaled <= EXPLAINED
    is_scale = is_other and BETTER * scaled < least
    times = as_given / max(scaled if is_scale else least, 1e-9)
    better = f"{times:.{0 if times > 10.0 else 1}f} times better with"
    if is_scale:
        return f"{better} gyr * {float(f'{scale:.2g}'):g}: its unit, or the times, are others"
    if not (times > BETTER and least <= EXPLAINED):
        is_unit = times > MUCH_BETTER and unit_scale != 1.0
        return f"{better} gyr{unit}" if is_unit else None
    if is_field and unit_scale == 1.0 and np.linalg.det(turn) > 0.0:
        # a rotation: the axes of either may be others
        return f"{better} {as_written('mag', turn.T)}, or with {as_written('gyr', turn)}"
    return f"{better} {as_written('gyr', turn, unit)}"
