"""The attitude that velocity alone tells, where no field can give the first heading.

What the accelerometer has felt, turned to the gyro-propagated frame G and added up over a
second, is the change of velocity less gravity's, seen from a frame that is turned against NED:
Wahba's problem over such windows. Heading shows as soon as the vehicle has accelerated in the
horizontal. Source: Y. Wu and X. Pan 2013, "Velocity/position integration formula part I",
doi 10.1109/TAES.2013.6494395; the solution by SVD is Markley's (estimator/alignment.py).
"""

from math import exp as real_exp
from math import radians, sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.types import Report
from estimator.alignment import nearest_rotation, quaternion_from_matrix
from estimator.compiled import inlined
from estimator.quaternion import add, rotate, scale, subtract
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

Nine = tuple[float, float, float, float, float, float, float, float, float]

WINDOW_S = 1.0  # long against a report's noise, short against the gyroscope's drift
LONGEST_WINDOW_S = 3.0  # of more the velocity in between is not known well enough
MEMORY_S = 30.0  # the gyroscope's drift in G over this is small against a heading's error
LEAST_WINDOWS = 3.0
LEAST_EXPLAINED_M2_S2 = 4.0  # of horizontal velocity changes that both sensors agree on
ENOUGH_SIGMA_RAD = radians(10.0)
CORRELATED = 4.0  # windows in a row share their errors: so many times the variance


class Search(NamedTuple):
    """An open window, and what closed ones have shown: B = sum a b', a in NED, b in G."""

    pushed_m_s: Vec3  # specific force, integrated in G since the window began
    force_m_s2: Vec3  # the last sample's, in G
    time_s: float  # since the window began
    velocity_ned_m_s: Vec3  # then
    is_open: bool
    correlation: Nine
    squares: float  # sum of |a|^2 + |b|^2
    windows: float


NOTHING_FOUND = Search(
    ZERO_VEC3,
    ZERO_VEC3,
    0.0,
    ZERO_VEC3,
    False,
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    0.0,
    0.0,
)


class Found(NamedTuple):
    """Attitude of the frame G, and how uncertain its heading is."""

    q_ned_g: Quaternion
    sigma_heading_rad: float


@inlined
def felt(search: Search, q_g_frd: Quaternion, acc: Vec3, dt: float) -> Search:
    """One sample by the trapezoid."""
    force = rotate(q_g_frd, acc)
    before = search.force_m_s2 if search.time_s > 0.0 else force
    return Search(
        add(search.pushed_m_s, scale(0.5 * dt, add(force, before))),
        force,
        search.time_s + dt,
        search.velocity_ned_m_s,
        search.is_open,
        search.correlation,
        search.squares,
        search.windows,
    )


@inlined
def reopened(search: Search, report: Report) -> Search:
    """A new window that begins at this report."""
    return Search(
        (0.0, 0.0, 0.0),
        search.force_m_s2,
        0.0,
        report.velocity_ned_m_s,
        True,
        search.correlation,
        search.squares,
        search.windows,
    )


@inlined
def heard(search: Search, report: Report) -> tuple[Search, bool]:
    """A report at the last sample; also whether it has closed a window."""
    T = search.time_s
    if not search.is_open or T > LONGEST_WINDOW_S:
        return reopened(search, report), False
    if T < WINDOW_S:
        return search, False
    change = subtract(report.velocity_ned_m_s, search.velocity_ned_m_s)
    fall = -STANDARD_GRAVITY_M_S2 * T
    a = (change[0], change[1], (change[2] if report.has_vertical else 0.0) + fall)
    b = search.pushed_m_s
    keep = real_exp(-T / MEMORY_S)
    B = search.correlation
    squares = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    squares += b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    closed = Search(
        b,
        search.force_m_s2,
        T,
        search.velocity_ned_m_s,
        True,
        (
            keep * B[0] + a[0] * b[0],
            keep * B[1] + a[0] * b[1],
            keep * B[2] + a[0] * b[2],
            keep * B[3] + a[1] * b[0],
            keep * B[4] + a[1] * b[1],
            keep * B[5] + a[1] * b[2],
            keep * B[6] + a[2] * b[0],
            keep * B[7] + a[2] * b[1],
            keep * B[8] + a[2] * b[2],
        ),
        keep * search.squares + squares,
        keep * search.windows + 1.0,
    )
    return reopened(closed, report), True


def found(search: Search) -> Found | None:
    """The attitude of G that fits best, if its heading is certain enough to begin with.

    min sum |a - R b|^2 has the variance of one axis, loss / (3 windows), and the horizontal
    changes that R explains say how well they hold the heading.
    """
    if search.windows < LEAST_WINDOWS:
        return None
    B = np.array(search.correlation).reshape(3, 3)
    R = nearest_rotation(B)
    together = B @ R.T
    explained = float(together[0, 0] + together[1, 1])
    if explained < LEAST_EXPLAINED_M2_S2:
        return None
    loss = max(0.0, search.squares - 2.0 * float(np.trace(together)))
    sigma = sqrt(CORRELATED * loss / (3.0 * search.windows) / explained)
    return Found(quaternion_from_matrix(R), sigma) if sigma < ENOUGH_SIGMA_RAD else None
