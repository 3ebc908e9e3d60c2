"""Signs of an unsensed turn that stay after it.

A field that looks as usual and points elsewhere: a turn about the vertical, or steel. Gravity that
keeps pulling elsewhere than the low-passed one: a turn about a level axis.
"""

from math import cos, pi, sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.events.jump_signs import MOST_USUAL
from estimator.conditioning.field.magnetic import MagneticState, robust_factor
from estimator.conditioning.params import (
    CONFIRM_S,
    LATELY_S,
    LONG_S,
    LONGEST_STEP_S,
    MOST_DEVIATION,
    QUICK_S,
    SPAN_S,
    USUAL_S,
    ConditioningParams,
)
from estimator.conditioning.vertical.bias import SETTLED_HEADING_RAD, Estimate
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.lowpass import largest_lead
from estimator.conditioning.vertical.slow_acceleration import MOST_APART_RAD, PRIOR_VARIANCE
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import (
    HALF_TURN_VARIANCE,
    angle_between_vectors,
    direction,
    norm,
    square,
)
from estimator.types import STANDARD_GRAVITY_M_S2, Vec2


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """For how long (s) something has held, which it has if it ``holds`` now."""
    return lasted_s + min(dt_s, LONGEST_STEP_S) if holds else 0.0


# The largest part of a turn by which the force of ``SPAN_S`` is ahead of the low-passed one,
# with the usual ``gravity_tau_s``.
SPAN_LEAD = largest_lead(SPAN_S, ConditioningParams().gravity_tau_s)
# A field points to a heading given up again within this share of the angle by which it is off the
# present one.
STILL_OFF = 0.5


class HeadingSigns(NamedTuple):
    """What the field shows about an unsensed turn about the vertical."""

    mean_north: float = 0.0  # of the field weighted by its confidence, in the field's own unit
    mean_east: float = 0.0  # of that field, too
    mean_confidence: float = 0.0  # of the field, averaged over the same time
    scatter: float = LEAST_OFF_RAD**2  # mean square angle that the mean field is off, rad^2
    confirmed_s: float = SPAN_S  # for how long, less the time against it, the field has agreed
    other_rad: float = 0.0  # the heading that was given up last
    other_s: float = 0.0  # for how much longer that is remembered
    back_s: float = 0.0  # for how long the field has pointed there again


@inlined
def watch_heading(
    params: ConditioningParams,
    state: HeadingSigns,
    estimate: Estimate,
    field: MagneticState,
    horizontal: Vec2,
    dt_s: float,
) -> HeadingSigns:
    """Look for a field that has its usual norm and dip, and keeps pointing elsewhere.

    A magnet that turns the field nearly always changes its norm or dip too, so that its confidence
    falls; after a turn of the vehicle about the vertical both are as learnt. ``confirmed_s`` sums
    what the means show, in seconds of a field of full confidence.
    """
    north, east = horizontal
    c = field.look.confidence
    a = dt_s / (SPAN_S + dt_s)
    n = state.mean_north + a * (c * north - state.mean_north)
    e = state.mean_east + a * (c * east - state.mean_east)
    w = state.mean_confidence + a * (c - state.mean_confidence)
    known = 4.0 * estimate.covariance[9] < HALF_TURN_VARIANCE  # else it follows the field anyway
    away = direction(n, e)
    # how surely that is an angle that honest drift does not reach, 0..1
    elsewhere = 1.0 - 1.0 / robust_factor((away / params.turn_heading_rad) ** 2) if known else 0.0
    confirmed_s = confirmed_time_s(params, state, estimate.heading_rad - away, elsewhere, c, dt_s)
    if field.reference.is_new:  # the heading was that of a field that is not believed any more
        confirmed_s = min(confirmed_s, SPAN_S)
    back = likely(c) > 0.0 and is_back(params, state, estimate.heading_rad, horizontal)
    b = dt_s / (USUAL_S + dt_s) if estimate.covariance[9] < SETTLED_HEADING_RAD**2 else 0.0
    return state._replace(
        mean_north=n,
        mean_east=e,
        mean_confidence=w,
        scatter=state.scatter + b * (away * away - state.scatter),
        confirmed_s=confirmed_s,
        other_s=max(0.0, state.other_s - dt_s),
        back_s=duration_s(known and back, state.back_s, dt_s),
    )


@inlined
def is_back(
    params: ConditioningParams, state: HeadingSigns, heading_rad: float, horizontal: Vec2
) -> bool:
    """Whether a field that looks as usual points to the heading that was given up lately.

    That a magnet has gone is far likelier than two unsensed turns that end where they began: it
    needs no more than that noise is none.
    """
    away = direction(horizontal[0], horizontal[1])
    apart = heading_rad - away - state.other_rad
    near = 1.0 - cos(apart) < STILL_OFF**2 * (1.0 - cos(away))
    far = cos(away) < cos(params.turn_heading_rad)
    return state.other_s > 0.0 and near and far


@inlined
def likely(confidence: float) -> float:
    """How well a field of that confidence fits the one expected: 1 - D^2, no less than 0."""
    return max(0.0, 2.0 - 1.0 / sqrt(max(confidence, TINY)))


@inlined
def confirmed_time_s(
    params: ConditioningParams,
    state: HeadingSigns,
    by_field_rad: float,
    elsewhere: float,
    confidence: float,
    dt_s: float,
) -> float:
    """For how long (s) the field has confirmed the heading, less the time for which it has not.

    A heading that was given up lately, and that the field points to again, is confirmed as fast as
    a new one.
    """
    apart = by_field_rad - state.other_rad
    again = state.other_s > 0.0 and cos(apart) > cos(params.turn_heading_rad)
    most = SPAN_S if again and elsewhere > 0.5 else CONFIRM_S
    gain = likely(confidence) * (1.0 - 2.0 * elsewhere) * min(dt_s, LONGEST_STEP_S)
    return max(0.0, min(state.confirmed_s + gain, most))


@inlined
def begin_anew(state: HeadingSigns) -> HeadingSigns:
    """The signs after a turn was found: means and times start at nothing."""
    return state._replace(mean_north=0.0, mean_east=0.0, mean_confidence=0.0, back_s=0.0)


@inlined
def give_up(state: HeadingSigns, heading_rad: float) -> HeadingSigns:
    """The signs after ``heading_rad`` was given up, which is remembered for ``LONG_S``.

    A field that keeps turning takes the heading along in steps: of those the first is remembered.
    """
    is_same = state.other_s > LONG_S - LATELY_S
    other_rad = state.other_rad if is_same else heading_rad
    return begin_anew(state)._replace(confirmed_s=SPAN_S, other_rad=other_rad, other_s=LONG_S)


class GravitySigns(NamedTuple):
    """What the specific force shows about an unsensed turn about a level axis."""

    off_s: float = 0.0  # for how long gravity has pulled far elsewhere
    unusual: float = 0.0  # square of how far it lies off beyond what is usual, rad^2
    unusual_s: float = 0.0  # for how long it has, as a turn leaves it
    turned: float = 0.0  # variance (rad^2) of the turn that this shows now; 0: none
    force_scatter: float = PRIOR_VARIANCE  # mean square angle between quick and slow gravity, rad^2
    apart: float = 0.0  # mean square angle between published gravity and its long mean, rad^2
    uneven: float = 0.0  # mean square of how far the size of gravity is off, as a share


@inlined
def watch_gravity(
    params: ConditioningParams,
    state: GravitySigns,
    gravity: GravityState,
    dt_s: float,
    inflation: float,
    weighed: float,
    has_field: bool,
) -> GravitySigns:
    """Look for gravity that keeps pulling elsewhere than the low-passed one in G.

    Accelerations reverse within a second or two and rarely exceed 1 g, a turn stays. A vertical
    that is ``weighed`` has a variance that decides how far to believe the force. Without a field
    whose jump would show it sooner, a force that lies off the vertical by more than is usual, for
    longer than a quick motion lasts, shows a smaller turn. An acceleration across makes it
    1/cos(off) as large, a turn leaves its size: the likelier counts.
    """
    f, quick = gravity.force.down.value, gravity.force.quick
    # Falling, or in the middle of a turn, the force has no direction to compare.
    falls = square(quick) <= (1.0 - MOST_DEVIATION) ** 2 * square(f)
    off = 0.0 if falls else angle_between_vectors(quick, f)
    elsewhere = weighed == 0.0 and off > MOST_APART_RAD
    usual = MOST_USUAL**2 * (state.force_scatter + inflation)
    unusual = 0.0 if has_field or weighed > 0.0 else max(0.0, off * off - usual)
    along = cos(off) if off < 0.5 * pi else 0.0
    keeps_size = square(quick) * along**2 <= 0.5 * (1.0 + along**2) * square(f)
    is_off = keeps_size and unusual > (0.5 * params.turn_heading_rad) ** 2
    unusual_s = duration_s(is_off, state.unusual_s, dt_s)
    a = dt_s / (LATELY_S + dt_s) if inflation == 0.0 else 0.0
    lag = angle_between_vectors(gravity.force.best.value, gravity.force.long)
    size = norm(f) / STANDARD_GRAVITY_M_S2 - 1.0
    b = dt_s / (min(LATELY_S, gravity.force.age_s) + dt_s)
    return GravitySigns(
        off_s=duration_s(elsewhere, state.off_s, dt_s),
        unusual=unusual,
        unusual_s=unusual_s,
        turned=(off / SPAN_LEAD) ** 2 if unusual_s > QUICK_S else 0.0,
        force_scatter=state.force_scatter + a * (off * off - state.force_scatter),
        apart=state.apart + b * (lag * lag - state.apart),
        uneven=state.uneven + b * (size * size - state.uneven),
    )
