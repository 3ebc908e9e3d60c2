"""The attitude that velocity alone tells, where no field can give the first heading.

What the accelerometer has felt, turned to the gyro-propagated frame G and added up over a
second, is the change of velocity less gravity's, seen from a frame that is turned against NED:
Wahba's problem over such windows. Heading shows as soon as the vehicle has accelerated in the
horizontal in more than one way: while it does so steadily, gravity is not told from it.
Source: Y. Wu and X. Pan 2013, "Velocity/position integration formula part I",
doi 10.1109/TAES.2013.6494395; the solution by SVD is Markley's (estimator/filter/alignment.py).
"""

from math import exp as real_exp
from math import radians, sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.types import Array, Report
from estimator.compilation.compiled import inlined
from estimator.filter.alignment import nearest_rotation, quaternion_from_matrix
from estimator.geometry.quaternion import add, cross, dot, rotate, scale, subtract
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

Nine = tuple[float, float, float, float, float, float, float, float, float]

WINDOW_S = 1.0  # long against a report's noise, short against the gyroscope's drift
LONGEST_WINDOW_S = 3.0  # of more the velocity in between is not known well enough
MEMORY_S = 30.0  # the gyroscope's drift in G over this is small against a heading's error
LEAST_WINDOWS = 3.0
LEAST_EXPLAINED_M2_S2 = 4.0  # of velocity changes across the axis that is known least
ENOUGH_SIGMA_RAD = radians(10.0)
CORRELATED = 4.0  # windows in a row share their errors: so many times the variance


class Window(NamedTuple):
    """What has been felt since a report; vectors but the velocity are in G."""

    pushed_m_s: Vec3  # specific force, integrated
    force_m_s2: Vec3  # the last sample's
    first_force_m_s2: Vec3  # when the window began
    time_s: float  # since then
    velocity_ned_m_s: Vec3  # then
    is_open: bool


class Evidence(NamedTuple):
    """Sums over the closed windows, of changes a of velocity in NED and what was felt, b, in G."""

    correlation: Nine  # B = sum a b'
    aged: Nine  # sum of a b' times how long ago, s
    lagging: Vec3  # sum b x (what the force changed by): how B turns for each second of delay
    squares: float  # sum of |a|^2 + |b|^2
    windows: float
    late_sigma_s: float  # of the reports


class Search(NamedTuple):
    """An open window, and what the closed ones say."""

    window: Window
    evidence: Evidence


NOTHING: Nine = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
EMPTY_SEARCH = Search(
    Window(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3, 0.0, ZERO_VEC3, False),
    Evidence(NOTHING, NOTHING, ZERO_VEC3, 0.0, 0.0, 0.0),
)


class Solution(NamedTuple):
    """Attitude of the frame G, and how uncertain its heading is."""

    q_ned_g: Quaternion
    sigma_heading_rad: float


@inlined
def add_sample(search: Search, q_g_frd: Quaternion, acc: Vec3, dt: float) -> Search:
    """One sample by the trapezoid."""
    window = search.window
    force = rotate(q_g_frd, acc)
    return Search(
        Window(
            add(window.pushed_m_s, scale(0.5 * dt, add(force, window.force_m_s2))),
            force,
            window.first_force_m_s2,
            window.time_s + dt,
            window.velocity_ned_m_s,
            window.is_open,
        ),
        search.evidence,
    )


@inlined
def open_window(window: Window, report: Report, behind_s: float) -> Window:
    """A new one that begins at this report, ``behind_s`` before the last sample."""
    force = window.force_m_s2
    return Window(scale(behind_s, force), force, force, behind_s, report.velocity_ned_m_s, True)


@inlined
def add_report(search: Search, report: Report, report_lag_s: float) -> tuple[Search, bool]:
    """A report, and whether it has closed a window.

    It tells the velocity ``ago_s`` before the last sample, and of ``report_lag_s`` before that
    where its age is uncertain.
    """
    window = search.window
    behind_s = report.ago_s + (report_lag_s if report.late_sigma_s > 0.0 else 0.0)
    time_s = window.time_s - behind_s
    opened = open_window(window, report, behind_s)
    if not window.is_open:
        return Search(opened, search.evidence), False
    if time_s > LONGEST_WINDOW_S:
        return Search(opened, fade(search.evidence, time_s)), False
    if time_s < WINDOW_S:
        return search, False
    change = subtract(report.velocity_ned_m_s, window.velocity_ned_m_s)
    vertical = change[2] if report.has_vertical else 0.0
    a = (change[0], change[1], vertical - STANDARD_GRAVITY_M_S2 * time_s)
    b = subtract(window.pushed_m_s, opened.pushed_m_s)
    swing = subtract(window.force_m_s2, window.first_force_m_s2)
    before = fade(search.evidence, time_s)
    evidence = Evidence(
        add_outer(before.correlation, 1.0, a, b),
        add_outer(before.aged, 0.5 * time_s, a, b),
        add(before.lagging, cross(b, swing)),
        before.squares + dot(a, a) + dot(b, b),
        before.windows + 1.0,
        max(before.late_sigma_s, report.late_sigma_s),
    )
    return Search(opened, evidence), True


@inlined
def fade(evidence: Evidence, time_s: float) -> Evidence:
    """What was shown, ``time_s`` later."""
    keep = real_exp(-time_s / MEMORY_S)
    return Evidence(
        weighted_sum(keep, evidence.correlation, 0.0, evidence.correlation),
        weighted_sum(keep, evidence.aged, keep * time_s, evidence.correlation),
        scale(keep, evidence.lagging),
        keep * evidence.squares,
        keep * evidence.windows,
        evidence.late_sigma_s,
    )


@inlined
def weighted_sum(x: float, A: Nine, y: float, B: Nine) -> Nine:
    """x A + y B."""
    return (
        x * A[0] + y * B[0],
        x * A[1] + y * B[1],
        x * A[2] + y * B[2],
        x * A[3] + y * B[3],
        x * A[4] + y * B[4],
        x * A[5] + y * B[5],
        x * A[6] + y * B[6],
        x * A[7] + y * B[7],
        x * A[8] + y * B[8],
    )


@inlined
def add_outer(A: Nine, x: float, a: Vec3, b: Vec3) -> Nine:
    """A + x a b'."""
    return (
        A[0] + x * a[0] * b[0],
        A[1] + x * a[0] * b[1],
        A[2] + x * a[0] * b[2],
        A[3] + x * a[1] * b[0],
        A[4] + x * a[1] * b[1],
        A[5] + x * a[1] * b[2],
        A[6] + x * a[2] * b[0],
        A[7] + x * a[2] * b[1],
        A[8] + x * a[2] * b[2],
    )


def solve(search: Search, bias_sigma_rad_s: float) -> Solution | None:
    """The attitude of G that fits best, if its heading is certain enough to begin with.

    min sum |a - R b|^2 has the variance of one axis, loss / (3 windows); a small turn t in NED
    changes a residual by t x R b, so M = sum (|b|^2 I - R b b' R') is the information about t.
    What the reports' age and the gyroscope's bias may have done comes on top: each pulls the
    residuals one way for as long as the vehicle goes on in the same manner, and no loss shows it.
    """
    evidence = search.evidence
    if evidence.windows < LEAST_WINDOWS:
        return None
    B = np.array(evidence.correlation).reshape(3, 3)
    R = nearest_rotation(B)
    together = B @ R.T
    M = _information(together)
    if float(np.linalg.eigvalsh(M)[0]) < LEAST_EXPLAINED_M2_S2:
        return None
    loss = max(0.0, evidence.squares - 2.0 * float(np.trace(together)))
    heading = np.linalg.inv(M)[2]  # how the heading follows M t
    by_age = evidence.late_sigma_s * float(heading @ R @ np.array(evidence.lagging))
    aged = np.array(evidence.aged).reshape(3, 3) @ R.T
    by_bias = bias_sigma_rad_s * float(np.linalg.norm(heading @ _information(aged)))
    by_noise = CORRELATED * loss / (3.0 * evidence.windows) * float(heading[2])
    sigma = sqrt(by_noise + by_age**2 + by_bias**2)
    return Solution(quaternion_from_matrix(R), sigma) if sigma < ENOUGH_SIGMA_RAD else None


def _information(together: Array) -> Array:
    """(3, 3) tr(S) I - S for S = sum R b b' R', symmetric but for what does not fit."""
    S = 0.5 * (together + together.T)
    return np.asarray(np.trace(S) * np.eye(3) - S)
