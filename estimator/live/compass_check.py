"""Whether velocity contradicts the compass, and how the compass is mounted.

The search for an attitude by velocity alone (:func:`estimator.aiding.search.solve`) goes on beside
the aided estimate. It is compared with the aided heading, which velocity may have
drawn half the way, and with a field as read that it has not confirmed. Where they differ by more
than their sigmas explain, compass and velocity are two hypotheses.

A compass that velocity has never confirmed is rejected at once, by its field alone after a while.
It is taken to be turned in the vehicle by the difference. The aiding begins again from velocity,
which shows the rest of that turn. A heading that velocity has confirmed before survives a sudden
contradiction, because velocity may be wrong: only a difference that lasts for ``MEMORY_S`` rejects
the compass. Meanwhile the heading's sigma is 45 deg. Where gyroscope and velocity go on agreeing,
and only the field does not, the compass has been turned since.

Here is also how far the field contradicts the accelerometer, whatever the gyroscope shows.
"""

from math import cos, hypot, sin

import numpy as np

from estimator.aiding import compass
from estimator.aiding.beginning import Start
from estimator.aiding.compass import Compass
from estimator.aiding.correction_cusum import with_unexpected_turn
from estimator.aiding.phase import Cause
from estimator.aiding.search import UNKNOWN_RAD, solve
from estimator.aiding.sources.field import begin_anew
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import COMPASS_TURN, HARD_IRON, SIZE, Report, Sigmas
from estimator.aiding.uncertainty import with_dip_error
from estimator.conditioning.field.magnetic import FieldLook, horizontal_down
from estimator.conditioning.params import CONFIRM_S, MEMORY_S, REACH, SPAN_S
from estimator.conditioning.rate import slow_share
from estimator.geometry.quaternion import angle_between_vectors, multiply, norm, rotate
from estimator.live.aiding_span import set_out
from estimator.live.core import Core
from estimator.live.settings import Settings
from estimator.live.situation import MOUNTED_RAD
from estimator.live.starts import (
    LEAST_HEADING_SIGMA_RAD,
    bias_sigma_rad_s,
    compass_turn,
    heading_between,
    judge_field,
)
from estimator.live.state import State

CERTAIN = Sigmas(inclination_rad=0.0, heading_rad=0.0)


def check_compass(state: State, report: Report) -> None:
    """Compare the compass with the heading by velocity, and act if they contradict."""
    now = state.core
    if not state.context.is_by_field:
        judge_mounting(state, now)
        return
    found = solve(now.search, bias_sigma_rad_s(now.conditioning))
    if found is None:
        return
    q = multiply(found.q_ned_g, now.gathered.q_g_frd)
    off_rad = heading_between(now.aided.estimate.q_ned_frd, q)
    sigma_rad = hypot(found.sigma_heading_rad, now.aided.sigma.heading_rad)
    turn_rad, turn_sigma_rad = off_rad, sigma_rad
    known = state.context.compass
    if not rolls(state.settings.aiding):
        turn_rad, turn_sigma_rad = compass_turn(state, now, found)
    is_consistent = known.confirmed or abs(turn_rad) <= REACH * turn_sigma_rad
    if is_consistent and abs(off_rad) <= REACH * sigma_rad:
        is_confirmed = found.sigma_heading_rad < 2.0 * LEAST_HEADING_SIGMA_RAD
        is_confirmed = known.confirmed or is_confirmed
        state.change_compass(confirmed=is_confirmed, contradicted_since_us=None)
        return
    since_us = known.contradicted_since_us or now.time_us
    state.change_compass(contradicted_since_us=since_us)
    lasting_s = 1e-6 * (now.time_us - since_us)
    if lasting_s < least_s(now, known, is_aided_off=abs(off_rad) > REACH * sigma_rad):
        return
    start = Start(
        q,
        max(found.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD),
        compass_sigma_rad=0.0 if rolls(state.settings.aiding) else UNKNOWN_RAD,
    )
    mislead(state, start, turn_rad, report)


def turns_compass(state: State) -> bool:
    """Read the compass as turned where the field alone contradicts the attitude; whether it was.

    Corrections have not turned the heading against the gyroscope, and velocity shows that heading.
    So the compass has been turned in the vehicle since velocity confirmed it, or turned back.
    """
    now, known = state.core, state.context.compass
    without_field = now.aided._replace(field=begin_anew(now.aided.field))
    is_by_field_alone = now.aided.field.far_off_s > CONFIRM_S and is_credible(without_field)
    is_judged = known.confirmed or compass.is_contradicted(known, now.time_us)
    if not is_judged or not is_by_field_alone or rolls(state.settings.aiding):
        return False
    found = solve(now.search, bias_sigma_rad_s(now.conditioning))
    has_turned = with_unexpected_turn(CERTAIN, now.aided.correction_cusum, now.covariance)
    if found is None or has_turned.heading_rad > 0.0:
        return False
    q = multiply(found.q_ned_g, now.gathered.q_g_frd)
    off_rad = heading_between(now.aided.estimate.q_ned_frd, q)
    turn_rad, turn_sigma_rad = compass_turn(state, now, found)
    if abs(off_rad) > REACH * found.sigma_heading_rad or abs(turn_rad) <= REACH * turn_sigma_rad:
        return False
    state.turn_compass(turn_rad, turn_sigma_rad)
    state.change_context(is_by_field=False)
    return True


def least_s(now: Core, known: Compass, *, is_aided_off: bool) -> float:
    """For how long a contradiction must last; the search of a slow stream is wrong for seconds."""
    if known.confirmed:
        return MEMORY_S
    if is_aided_off:
        return 0.0
    return CONFIRM_S if slow_share(now.sample.dt_s) > 0.0 else SPAN_S


def judge_mounting(state: State, now: Core) -> None:
    """The rest of a turned compass's turn, by a heading from velocity.

    Once that is known better than a calibration vouches for, readings are turned back by it, too.
    """
    estimate, known = now.aided.estimate, state.context.compass
    if not now.seen.has_heading or not state.knows_north or rolls(state.settings.aiding):
        return
    if not known.confirmed and known.turned_rad == 0.0:
        sigma = now.aided.sigma
        start = Start(estimate.q_ned_frd, sigma.heading_rad, sigma.inclination_rad)
        judge_field(state, start)
        if state.context.compass.turned_rad != known.turned_rad:  # it has been turned by now
            return
    variance = now.covariance[COMPASS_TURN, COMPASS_TURN]
    if not 0.0 < 2.0 * variance < MOUNTED_RAD**2:
        return
    if abs(estimate.compass_turn_rad) > MOUNTED_RAD:
        state.turn_compass(estimate.compass_turn_rad)
    elif not known.confirmed:
        state.change_compass(confirmed=True)


def mislead(state: State, start: Start, turn_rad: float, report: Report) -> None:
    """Begin again from the attitude by velocity; the compass is turned by ``turn_rad``."""
    now = state.core
    state.enter(Cause.MISLED)
    if rolls(state.settings.aiding):  # iron all around turns a field, too: it is left out
        state.contradict_compass()
    else:
        state.turn_compass(turn_rad)
    state.set_core(state.core._replace(search=now.search))
    set_out(state, start, report, has_heading=False)


def dip_error_rad(settings: Settings, core: Core) -> float:
    """How far (rad) force and field as read lie otherwise apart than velocity and place have it.

    The force is that of the last second or so, which the change of velocity explains. What was
    learnt of the field meanwhile does not count, and what calibration leaves over is no
    contradiction. 0 without either, and while the place is unknown.
    """
    params, place_gauss = settings.aiding, settings.reference.place_gauss
    force, sample = core.consistency.force, core.sample
    n = norm(sample.mag)
    if not sample.has_mag or force.share == 0.0 or norm(place_gauss) == 0.0 or n == 0.0:
        return 0.0
    apart = angle_between_vectors(force.g, rotate(core.consistency.q_g_frd, sample.mag))
    dip = np.arctan2(*horizontal_down(place_gauss)[::-1])
    dip += apart - angle_between_vectors(force.ned, place_gauss)
    as_read = core.aided.field._replace(look=FieldLook(n * cos(dip), n * sin(dip), 0.0))
    calibrated = np.zeros((SIZE, SIZE))
    calibrated[HARD_IRON, HARD_IRON] = params.hard_iron_sigma_gauss**2
    return with_dip_error(params, CERTAIN, as_read, place_gauss, calibrated).inclination_rad
