"""The attitude from velocity alone.

The specific force, turned to the gyro-propagated frame G and integrated over a second, is the
change of velocity minus that by gravity, seen from G. How G is turned against NED is Wahba's
problem, with a pair of such vectors for each window. The heading shows once the vehicle has
accelerated horizontally in more than one direction: a steady acceleration looks like a part of
gravity. Source: Y. Wu and X. Pan 2013, "Velocity/position integration formula part I", doi
10.1109/TAES.2013.6494395; the solution by SVD is Markley's (estimator/filter/alignment.py).
"""

from math import exp as real_exp
from math import radians, sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.beginning import BEGIN_VELOCITY_SIGMA_M_S
from estimator.aiding.course import STANDING, Rolled, fade_rolled, roll_on
from estimator.aiding.types import Array, Report
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import (
    ACCELERATION_LASTS_S,
    HEADING_REACH_RAD,
    MEMORY_S,
    REACH,
    SPAN_S,
)
from estimator.filter.alignment import nearest_rotation, quaternion_from_matrix
from estimator.geometry.quaternion import (
    add,
    cross,
    dot,
    norm,
    rotate,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

Matrix = tuple[Vec3, Vec3, Vec3]  # row by row
NOTHING: Matrix = (ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)

# With a heading less certain than this (rad), as by an uncalibrated compass, no aiding begins.
UNKNOWN_RAD = radians(45.0)
# Windows share reports and their slow error: so many times the variance of independent ones.
CORRELATED = 4.0


class Window(NamedTuple):
    """What the accelerometer has measured since a report opened the window."""

    pushed_m_s: Vec3 = ZERO_VEC3  # integral of the specific force, in G
    force_m_s2: Vec3 = ZERO_VEC3  # the last sample's specific force, in G
    first_force_m_s2: Vec3 = ZERO_VEC3  # the specific force when the window began, in G
    time_s: float = 0.0  # since the window began
    longest_step_s: float = 0.0  # since then
    velocity_ned_m_s: Vec3 = ZERO_VEC3  # by the report that opened it
    late_sigma_s: float = 0.0  # uncertainty of the age of that report
    is_open: bool = False  # until the first report
    is_behind_hole: bool = False  # the first one behind a hole in the stream


class Push(NamedTuple):
    """What one window has shown, or the first one behind a hole so far."""

    change_ned_m_s: Vec3 = ZERO_VEC3  # of velocity, without gravity
    force_g_m_s: Vec3 = ZERO_VEC3  # the specific force, integrated, in G
    swing_g_m_s2: Vec3 = ZERO_VEC3  # from the first specific force to the last, in G
    longest_step_s: float = 0.0  # in which the vehicle may have turned anyhow
    is_behind_hole: bool = False  # it depends on nothing before a hole in the stream


class Evidence(NamedTuple):
    """Sums over closed windows of a, the change of velocity without gravity (NED), and b, in G.

    b is the integrated specific force. Older windows count less.
    """

    correlation: Matrix = NOTHING  # B = sum a b', (m/s)^2
    aged: Matrix = NOTHING  # sum of a b' times the window's age, (m/s)^2 s
    # sum of b x (change of force): how B turns per second of delay, (m/s)^2/s
    lagging: Vec3 = ZERO_VEC3
    squares: float = 0.0  # sum of |a|^2 + |b|^2, (m/s)^2
    windows: float = 0.0  # how many, older ones in part
    rolled: Rolled = STANDING  # where that goes by its course
    late_sigma_s: float = 0.0  # uncertainty of the reports' age
    latest: Push = Push()  # what was shown last


class Search(NamedTuple):
    """The open window, and the evidence of the closed ones."""

    window: Window = Window()
    evidence: Evidence = Evidence()


EMPTY_SEARCH = Search()
# Behind a hole in the stream the attitude may be off by any angle, so the first window shows it at
# each report.
SEARCH_ANEW = Search(Window(is_behind_hole=True))


class Solution(NamedTuple):
    """Attitude of the frame G, and how uncertain it is."""

    q_ned_g: Quaternion
    sigma_heading_rad: float
    sigma_tilt_rad: float = 0.0  # 0: not computed


@inlined
def add_sample(
    search: Search, q_g_frd: Quaternion, acc: Vec3, dt: float, aliasing: float
) -> Search:
    """Integrate one sample's specific force by the trapezoid.

    If the step has missed a turn of the variance ``aliasing`` (rad^2), earlier evidence belongs to
    another G and counts less.
    """
    window = extend_window(search.window, rotate(q_g_frd, acc), dt)
    return Search(window, fade(search.evidence, aliasing, 0.0))


@inlined
def extend_window(window: Window, force_g: Vec3, dt: float) -> Window:
    """The window one sample longer, whose specific force is given in G."""
    return window._replace(
        pushed_m_s=add(window.pushed_m_s, scale(0.5 * dt, add(force_g, window.force_m_s2))),
        force_m_s2=force_g,
        time_s=window.time_s + dt,
        longest_step_s=max(window.longest_step_s, dt),
    )


@inlined
def open_window(window: Window, report: Report, behind_s: float) -> Window:
    """A new window that begins with this report, ``behind_s`` before the last sample."""
    force = window.force_m_s2
    return Window(
        pushed_m_s=scale(behind_s, force),
        force_m_s2=force,
        first_force_m_s2=force,
        time_s=behind_s,
        longest_step_s=0.0,
        velocity_ned_m_s=report.velocity_ned_m_s,
        late_sigma_s=report.late_sigma_s,
        is_open=True,
        is_behind_hole=window.is_behind_hole and not window.is_open,
    )


@inlined
def shows_motion(window: Window) -> bool:
    """Whether the latest report shows a speed at which a slow turn tilts the force."""
    is_new = window.is_open and window.time_s < ACCELERATION_LASTS_S
    return is_new and norm(window.velocity_ned_m_s) > REACH * BEGIN_VELOCITY_SIGMA_M_S


@inlined
def push_by(window: Window, opened: Window, report: Report) -> Push:
    """What the window shows up to the report that would open the next one."""
    time_s = window.time_s - opened.time_s
    change = subtract(report.velocity_ned_m_s, window.velocity_ned_m_s)
    vertical = change[2] if report.has_vertical else 0.0
    return Push(
        change_ned_m_s=(change[0], change[1], vertical - STANDARD_GRAVITY_M_S2 * time_s),
        force_g_m_s=subtract(window.pushed_m_s, opened.pushed_m_s),
        swing_g_m_s2=subtract(window.force_m_s2, window.first_force_m_s2),
        longest_step_s=window.longest_step_s,
        is_behind_hole=window.is_behind_hole,
    )


@inlined
def add_report(
    search: Search, report: Report, q_g_frd: Quaternion, down_frd: Vec3
) -> tuple[Search, bool]:
    """Take a report; whether ``latest`` is new: by a window that has closed, or behind a hole.

    The report shows the velocity ``ago_s`` before the last sample, or as much earlier as its age is
    uncertain. ``down_frd`` is the assumed down in the body's axes.
    """
    window, before = search
    behind_s = report.ago_s + report.late_sigma_s
    time_s = window.time_s - behind_s
    opened = open_window(window, report, behind_s)
    if not window.is_open:
        return Search(opened, before), False
    if time_s > ACCELERATION_LASTS_S:
        return Search(opened, fade(before, time_s / MEMORY_S, time_s)), False
    is_alike = (report.late_sigma_s > 0.0) == (window.late_sigma_s > 0.0)
    shows_early = window.is_behind_hole and is_alike and time_s > 0.0
    if time_s < SPAN_S and not shows_early:
        return search, False
    push = push_by(window, opened, report)
    late_sigma_s = max(before.late_sigma_s, window.late_sigma_s, report.late_sigma_s)
    if time_s < SPAN_S:
        return Search(window, before._replace(latest=push, late_sigma_s=late_sigma_s)), True
    a, b = push.change_ned_m_s, push.force_g_m_s
    felt = rotate_inverse(q_g_frd, b)
    before = fade(before, time_s / MEMORY_S, time_s)
    evidence = Evidence(
        correlation=add_scaled(before.correlation, 1.0, outer(a, b)),
        aged=add_scaled(before.aged, 0.5 * time_s, outer(a, b)),
        lagging=add(before.lagging, cross(b, push.swing_g_m_s2)),
        squares=before.squares + dot(a, a) + dot(b, b),
        windows=before.windows + 1.0,
        rolled=roll_on(before.rolled, window.velocity_ned_m_s, report, time_s, felt, down_frd),
        late_sigma_s=late_sigma_s,
        latest=push,
    )
    return Search(opened, evidence), True


@inlined
def fade(evidence: Evidence, loss: float, time_s: float) -> Evidence:
    """The evidence ``time_s`` later: it counts exp(-loss) as much, and what is left is older."""
    keep = real_exp(-loss)
    return evidence._replace(
        correlation=add_scaled(NOTHING, keep, evidence.correlation),
        aged=add_scaled(
            add_scaled(NOTHING, keep, evidence.aged), keep * time_s, evidence.correlation
        ),
        lagging=scale(keep, evidence.lagging),
        squares=keep * evidence.squares,
        windows=keep * evidence.windows,
        rolled=fade_rolled(evidence.rolled, keep),
    )


@inlined
def add_scaled(A: Matrix, x: float, B: Matrix) -> Matrix:
    """A + x B."""
    return add(A[0], scale(x, B[0])), add(A[1], scale(x, B[1])), add(A[2], scale(x, B[2]))


@inlined
def outer(a: Vec3, b: Vec3) -> Matrix:
    """a b'."""
    return scale(a[0], b), scale(a[1], b), scale(a[2], b)


def solve(search: Search, bias_sigma_rad_s: float) -> Solution | None:
    """The attitude of G that fits best, if its heading is certain enough to begin with.

    R minimises the loss, sum |a - R b|^2, by three parameters; loss / (3 windows - 3) is the
    variance of one component. A small turn t in NED changes a residual by t x R b, so M = sum
    (|b|^2 I - R b b' R') is the information about t. A wrong age of the reports or a bias of the
    gyroscope turns all vectors of a steady manoeuvre alike and leaves the loss small, so their
    turns are added to the variance.
    """
    evidence = search.evidence
    if evidence.windows <= 1.0:
        return None
    B = np.array(evidence.correlation)
    R = nearest_rotation(B)
    together = B @ R.T
    M = information(together)
    # changes of velocity must stand across every axis, by more than the first one may be off
    if float(np.linalg.eigvalsh(M)[0]) < BEGIN_VELOCITY_SIGMA_M_S**2:
        return None
    loss = max(0.0, evidence.squares - 2.0 * float(np.trace(together)))
    heading = np.linalg.inv(M)[2]  # how the heading follows M t
    by_age = evidence.late_sigma_s * float(heading @ R @ np.array(evidence.lagging))
    aged = np.array(evidence.aged) @ R.T
    by_bias = bias_sigma_rad_s * float(np.linalg.norm(heading @ information(aged)))
    by_noise = CORRELATED * loss / (3.0 * evidence.windows - 3.0) * float(heading[2])
    sigma = sqrt(by_noise + by_age**2 + by_bias**2)
    return Solution(quaternion_from_matrix(R), sigma) if sigma < HEADING_REACH_RAD else None


def information(together: Array) -> Array:
    """(3, 3) tr(S) I - S for S = sum R b b' R', symmetric but for what does not fit."""
    S = 0.5 * (together + together.T)
    return np.asarray(np.trace(S) * np.eye(3) - S)
