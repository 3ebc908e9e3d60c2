"""Which way a vehicle on wheels goes, and how far its vertical is off, from its pushes.

Its course is its heading or the opposite. Forwards, it is pushed as its velocity changes along the
course; in reverse, the other way round. A tilted vertical adds the same part of gravity to every
push, and so does an accelerometer's bias. So the scatter of the pushes about their mean shows the
way, and the mean shows the tilt.
"""

from math import hypot, log
from typing import NamedTuple

from estimator.aiding.types import AidingParams, Report
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import REACH, SPAN_S
from estimator.geometry.quaternion import cross, dot, scale, subtract, unit
from estimator.types import STANDARD_GRAVITY_M_S2, Vec2, Vec3


class Rolled(NamedTuple):
    """Sums over windows since it began to move; older ones count less. Accelerations, m/s^2."""

    windows: float = 0.0
    reported: Vec2 = (0.0, 0.0)  # along the course, and to the right of it
    felt: Vec2 = (0.0, 0.0)  # with what a tilt adds, along the body's level x axis and to its right
    squares: float = 0.0
    products: float = 0.0


STANDING = Rolled()


@inlined
def level_ahead(down_frd: Vec3) -> Vec3:
    """The body's x axis made level, a unit vector."""
    return unit(subtract((1.0, 0.0, 0.0), scale(down_frd[0], down_frd)))


@inlined
def roll_on(
    rolled: Rolled, before_m_s: Vec3, report: Report, time_s: float, pushed: Vec3, down_frd: Vec3
) -> Rolled:
    """Add a window of ``time_s`` from one velocity (NED) to that of a report.

    ``pushed`` is the integrated specific force (m/s) and ``down_frd`` the assumed down, both in the
    body's axes at the window's end. A vehicle that stands may go on either way.
    """
    after_m_s = report.velocity_ned_m_s
    speed, least = hypot(after_m_s[0], after_m_s[1]), REACH * report.sigma_m_s
    if speed <= least:
        return STANDING
    known = rolled if hypot(before_m_s[0], before_m_s[1]) > least else STANDING
    north, east = after_m_s[0] / speed, after_m_s[1] / speed
    change = (after_m_s[0] - before_m_s[0], after_m_s[1] - before_m_s[1])
    along = (north * change[0] + east * change[1]) / time_s
    across = (north * change[1] - east * change[0]) / time_s
    ahead = level_ahead(down_frd)
    felt_along = dot(pushed, ahead) / time_s
    felt_across = dot(pushed, cross(down_frd, ahead)) / time_s
    return Rolled(
        windows=known.windows + 1.0,
        reported=(known.reported[0] + along, known.reported[1] + across),
        felt=(known.felt[0] + felt_along, known.felt[1] + felt_across),
        squares=known.squares + along**2 + across**2 + felt_along**2 + felt_across**2,
        products=known.products + along * felt_along + across * felt_across,
    )


@inlined
def fade_rolled(rolled: Rolled, keep: float) -> Rolled:
    """The sums when only ``keep`` of them counts."""
    n, reported, felt, squares, products = rolled
    return Rolled(
        keep * n,
        (keep * reported[0], keep * reported[1]),
        (keep * felt[0], keep * felt[1]),
        keep * squares,
        keep * products,
    )


def mean_left(rolled: Rolled, sense: float) -> Vec2:
    """What of the pushes their reports leave unexplained on average; ``sense`` -1: in reverse."""
    n, reported, felt, _, _ = rolled
    return (felt[0] - sense * reported[0]) / n, (felt[1] - sense * reported[1]) / n


def scatter(rolled: Rolled, sense: float) -> float:
    """Variance of what is left about its mean, (m/s^2)^2, with that of two reports' noise.

    Where pushes hardly change, what is left of them is noise under either sense.
    """
    left = mean_left(rolled, sense)
    square = (rolled.squares - 2.0 * sense * rolled.products) / rolled.windows
    noise = AidingParams().receiver_noise_m_s / SPAN_S  # of an axis
    return max(0.0, square - left[0] ** 2 - left[1] ** 2) + 4.0 * noise * noise


def forward_evidence(rolled: Rolled) -> float:
    """Evidence for forwards against reverse: 2 ln of the likelihood ratio."""
    if rolled.windows <= 1.0:
        return 0.0
    return 2.0 * (rolled.windows - 1.0) * log(scatter(rolled, -1.0) / scatter(rolled, 1.0))


def tilt_error_rad(rolled: Rolled, sense: float) -> float:
    """How far off the vertical is that the pushes were seen by."""
    return hypot(*mean_left(rolled, sense)) / STANDARD_GRAVITY_M_S2
