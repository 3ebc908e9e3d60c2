"""Which way a vehicle on wheels goes, and how far its vertical is off, from its pushes.

Its course is its heading or the opposite. Forwards, it is pushed as its velocity changes along the
course; in reverse, the other way round. A tilted vertical adds the same part of gravity to every
push, and so does an accelerometer's bias. So the scatter of the pushes about their mean shows the
way, and the mean shows the tilt.
"""

from math import hypot, log
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.robust import REACH
from estimator.geometry.quaternion import cross, dot, scale, subtract, unit
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3


class Level(NamedTuple):
    """A vector's level parts."""

    along: float = 0.0
    across: float = 0.0  # to the right


class Rolled(NamedTuple):
    """Sums over windows since it began to move; older ones count less. Accelerations, m/s^2."""

    windows: float
    reported: Level  # along the course
    felt: Level  # along the body's level x axis, with what a tilt adds
    squares: float
    products: float


NO_PUSH = Level()
STANDING = Rolled(windows=0.0, reported=NO_PUSH, felt=NO_PUSH, squares=0.0, products=0.0)


@inlined
def level_ahead(down_frd: Vec3) -> Vec3:
    """The body's x axis made level, a unit vector."""
    return unit(subtract((1.0, 0.0, 0.0), scale(down_frd[0], down_frd)))


@inlined
def roll_on(
    rolled: Rolled,
    before_m_s: Vec3,
    after_m_s: Vec3,
    sigma_m_s: float,
    time_s: float,
    pushed_frd_m_s: Vec3,
    down_frd: Vec3,
) -> Rolled:
    """Add a window of ``time_s`` between two velocities (NED) that are known to ``sigma_m_s``.

    ``pushed_frd_m_s`` is the integrated specific force and ``down_frd`` the assumed down, both in
    the body's axes at the window's end. A vehicle that stands may go on either way.
    """
    speed, least = hypot(after_m_s[0], after_m_s[1]), REACH * sigma_m_s
    if speed <= least:
        return STANDING
    known = rolled if hypot(before_m_s[0], before_m_s[1]) > least else STANDING
    north, east = after_m_s[0] / speed, after_m_s[1] / speed
    change = (after_m_s[0] - before_m_s[0], after_m_s[1] - before_m_s[1])
    along = (north * change[0] + east * change[1]) / time_s
    across = (north * change[1] - east * change[0]) / time_s
    ahead = level_ahead(down_frd)
    felt_along = dot(pushed_frd_m_s, ahead) / time_s
    felt_across = dot(pushed_frd_m_s, cross(down_frd, ahead)) / time_s
    return Rolled(
        windows=known.windows + 1.0,
        reported=Level(known.reported.along + along, known.reported.across + across),
        felt=Level(known.felt.along + felt_along, known.felt.across + felt_across),
        squares=known.squares + along**2 + across**2 + felt_along**2 + felt_across**2,
        products=known.products + along * felt_along + across * felt_across,
    )


@inlined
def fade_rolled(rolled: Rolled, keep: float) -> Rolled:
    """The sums when only ``keep`` of them counts."""
    n, reported, felt, squares, products = rolled
    return Rolled(
        keep * n,
        Level(keep * reported.along, keep * reported.across),
        Level(keep * felt.along, keep * felt.across),
        keep * squares,
        keep * products,
    )


def mean_left(rolled: Rolled, sense: float) -> Level:
    """What of the pushes their reports leave unexplained on average; ``sense`` -1: in reverse."""
    n, reported, felt, _, _ = rolled
    return Level(
        (felt.along - sense * reported.along) / n, (felt.across - sense * reported.across) / n
    )


def scatter(rolled: Rolled, sense: float) -> float:
    """Variance of what is left about its mean, (m/s^2)^2."""
    left = mean_left(rolled, sense)
    square = (rolled.squares - 2.0 * sense * rolled.products) / rolled.windows
    return max(TINY, square - left.along**2 - left.across**2)


def forward_evidence(rolled: Rolled) -> float:
    """Evidence for forwards against reverse: 2 ln of the likelihood ratio."""
    if rolled.windows <= 1.0:
        return 0.0
    return 2.0 * (rolled.windows - 1.0) * log(scatter(rolled, -1.0) / scatter(rolled, 1.0))


def tilt_error_rad(rolled: Rolled, sense: float) -> float:
    """How far off the vertical is that the pushes were seen by."""
    return hypot(*mean_left(rolled, sense)) / STANDARD_GRAVITY_M_S2
