"""A field that looks as usual and points elsewhere: a turn about the vertical, or steel."""

from math import cos
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.events.duration import duration_s
from estimator.conditioning.field.magnetic import MagneticState
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import BORNE_S, LATELY_S, LONG_S, USUAL_S
from estimator.conditioning.vertical.bias import SETTLED_HEADING_RAD, Estimate
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import direction
from estimator.geometry.spread import HALF_TURN_VARIANCE
from estimator.types import Vec2

# A mean field that has pointed elsewhere does so still until it is within this share of the angle
# that told it: meanwhile the heading creeps towards it.
STILL_OFF = 0.5


class HeadingSigns(NamedTuple):
    """What the field says about an unsensed turn about the vertical."""

    mean_north: float = 0.0  # of the field weighted by its confidence, in the field's own unit
    mean_east: float = 0.0  # of that field, too
    mean_confidence: float = 0.0  # of the field, averaged over the same time
    off_s: float = 0.0  # for how long the mean field has pointed elsewhere
    scatter: float = (
        LEAST_OFF_RAD**2
    )  # mean square of how far the mean field points elsewhere, rad^2
    borne_s: float = 0.0  # for how long, less the time against it, the field has agreed
    other_rad: float = 0.0  # the heading that was given up last
    other_s: float = 0.0  # for how much longer that is remembered
    back_s: float = 0.0  # for how long the field has pointed there again


with_means = replacer(HeadingSigns, "mean_north", "mean_east", "mean_confidence", "off_s", "back_s")
with_other = replacer(HeadingSigns, "borne_s", "other_rad", "other_s")


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

    A magnet that turns the field nearly always changes its norm or dip too, so
    its confidence falls; after a turn of the vehicle about the vertical both
    are as learnt. The means over time are of the field weighted by its
    confidence.
    """
    north, east = horizontal
    c = field.look.confidence
    a = dt_s / (params.turn_heading_tau_s + dt_s)
    n = state.mean_north + a * (c * north - state.mean_north)
    e = state.mean_east + a * (c * east - state.mean_east)
    w = state.mean_confidence + a * (c - state.mean_confidence)
    known = 4.0 * estimate.covariance[9] < HALF_TURN_VARIANCE  # else it follows the field anyway
    away = direction(n, e)
    least = params.turn_heading_rad * (STILL_OFF if state.off_s > 0.0 else 1.0)
    off = known and abs(away) > least and w > params.turn_confidence
    borne_s = borne_out(params, state, estimate.heading_rad - away, off, c, dt_s)
    if field.reference.is_new:  # the heading was that of a field that is not believed any more
        borne_s = 0.0
    back = is_back(params, state, estimate, field, horizontal)
    b = dt_s / (USUAL_S + dt_s) if estimate.covariance[9] < SETTLED_HEADING_RAD**2 else 0.0
    return HeadingSigns(
        mean_north=n,
        mean_east=e,
        mean_confidence=w,
        off_s=duration_s(off, state.off_s, dt_s),
        scatter=state.scatter + b * (away * away - state.scatter),
        borne_s=borne_s,
        other_rad=state.other_rad,
        other_s=max(0.0, state.other_s - dt_s),
        back_s=duration_s(known and back, state.back_s, dt_s),
    )


@inlined
def is_back(
    params: ConditioningParams,
    state: HeadingSigns,
    estimate: Estimate,
    field: MagneticState,
    horizontal: Vec2,
) -> bool:
    """Whether the field, which looks as usual, points to the heading that was given up lately.

    That a magnet has gone is far likelier than two unsensed turns that end where they began: it
    needs no more than that noise is none.
    """
    away = direction(horizontal[0], horizontal[1])
    apart = estimate.heading_rad - away - state.other_rad
    near = 1.0 - cos(apart) < STILL_OFF**2 * (1.0 - cos(away))
    far = cos(away) < cos(params.turn_heading_rad)
    return state.other_s > 0.0 and near and far and field.look.confidence > params.turn_confidence


@inlined
def borne_out(
    params: ConditioningParams,
    state: HeadingSigns,
    by_field_rad: float,
    off: bool,
    confidence: float,
    dt_s: float,
) -> float:
    """For how long (s) the field has borne the heading out, less the time for which it has not.

    A heading that was given up lately and that the field points to again needs no more proof.
    """
    if not off:
        return min(state.borne_s + confidence * dt_s, BORNE_S)
    apart = by_field_rad - state.other_rad
    again = state.other_s > 0.0 and cos(apart) > cos(params.turn_heading_rad)
    return 0.0 if again else max(0.0, state.borne_s - dt_s)


@inlined
def begin_anew(state: HeadingSigns) -> HeadingSigns:
    """The signs after a turn was found: means and times start at nothing."""
    return with_means(state, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def give_up(state: HeadingSigns, heading_rad: float) -> HeadingSigns:
    """The signs after ``heading_rad`` was given up, which is remembered for ``LONG_S``.

    A field that keeps turning takes the heading along in steps: of those the first is remembered.
    """
    is_same = state.other_s > LONG_S - LATELY_S
    other_rad = state.other_rad if is_same else heading_rad
    return with_other(begin_anew(state), 0.0, other_rad, LONG_S)
