"""Whether velocity alone contradicts the heading that the compass gave the aided attitude.

The search for an attitude by velocity (:mod:`estimator.aiding.search`) goes on beside the aided
estimate and never uses the field. Where both are known and differ by more than their sigmas
explain, the compass is one hypothesis and velocity the other. A compass whose heading velocity has
never confirmed loses at once: the aiding begins again from velocity, and the field then shows
turns, not north. A heading that velocity has confirmed before is not given up for a sudden
contradiction, because velocity may be what went wrong: only a difference that lasts for
``MEMORY_S`` decides against the compass. Meanwhile the heading's sigma is 45 deg.
"""

from math import atan2, hypot, pi, remainder

from estimator.aiding.phase import Cause, Phase
from estimator.aiding.search import solve
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import Report
from estimator.conditioning.robust import REACH
from estimator.conditioning.times import MEMORY_S
from estimator.geometry.quaternion import conjugate, multiply
from estimator.live.aiding_span import (
    LEAST_HEADING_SIGMA_RAD,
    Start,
    bias_sigma_rad_s,
    judge_field,
    set_out,
)
from estimator.live.core import Core
from estimator.live.state import State
from estimator.types import Quaternion


def check_compass(state: State, report: Report) -> None:
    """Compare the aided heading with the one by velocity alone, and act if they contradict."""
    if state.context.phase is not Phase.AIDED:
        return
    now = state.core.core
    if not state.context.is_by_field:
        if now.seen.has_heading and state.knows_north and not rolls(state.settings.aiding):
            judge_field(state, now.aided.estimate.q_ned_frd, now.aided.sigma.heading_rad)
        return
    found = solve(now.search, bias_sigma_rad_s(now.conditioning))
    if found is None:
        return
    q = multiply(found.q_ned_g, now.conditioning.vertical.gravity.q_g_frd)
    off_rad = heading_between(q, now)
    sigma_rad = hypot(found.sigma_heading_rad, now.aided.sigma.heading_rad)
    known = state.context.compass
    if abs(off_rad) <= REACH * sigma_rad:
        is_confirmed = found.sigma_heading_rad < 2.0 * LEAST_HEADING_SIGMA_RAD
        known = known._replace(
            confirmed=known.confirmed or is_confirmed, contradicted_since_us=None
        )
        state.change_context(compass=known)
        return
    since_us = known.contradicted_since_us or now.time_us
    state.change_context(compass=known._replace(contradicted_since_us=since_us))
    if known.confirmed and now.time_us - since_us < 1e6 * MEMORY_S:
        return
    start = Start(q, max(found.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD))
    mislead(state, start, -off_rad, report)


def mislead(state: State, start: Start, off_rad: float, report: Report) -> None:
    """Begin again from the attitude by velocity; the compass is ``off_rad`` off and left out."""
    known = state.context.compass._replace(
        left_out_us=state.core.time_us,
        off_rad=off_rad,
        confirmed=False,
        contradicted_since_us=None,
    )
    state.change_context(compass=known)
    search = state.core.core.search
    state.enter(Cause.MISLED)
    state.set_core(state.core.core._replace(search=search))
    set_out(state, start, report, has_heading=False)


def heading_between(q: Quaternion, now: Core) -> float:
    """Angle (rad) about down from the aided attitude to ``q``."""
    w, _, _, z = multiply(q, conjugate(now.aided.estimate.q_ned_frd))
    return remainder(2.0 * atan2(z, w), 2.0 * pi)
