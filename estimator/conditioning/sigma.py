"""The angles that 68 % of the errors of inclination and heading lie under."""

from math import atan2, sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.heading import north_east, wrap_angle
from estimator.conditioning.magnetic import LEAST_HORIZONTAL
from estimator.conditioning.tilt import slowness
from estimator.conditioning.types import ConditioningParams, ConditioningState
from estimator.conditioning.unsensed_turn import OTHER_HEADING_S
from estimator.geometry.quaternion import rotate

# Parts of the inclination's sigma (rad): at rest, for a force that varies by 1 g, per swing.
SIGMA_STEADY_RAD = 0.0052
SIGMA_UNSTEADY_RAD = 0.03
SIGMA_SWING = 0.5
# Squares of what the size of the force, off by a share of gravity, tells about the inclination and,
# times the dip's tangent, about the heading; and of what the field's scatter tells.
SIGMA_UNEVEN_SQUARE = 2.0
SIGMA_BENT_SQUARE = 0.6
SIGMA_SCATTER_SQUARE = 2.0
# The share by which a heading given up may still be right once another has been borne out.
STILL_RIVAL = 0.15
# Mean square of how far norm and dip are off, as shares and angles, by noise alone; and the
# square of what more than that tells.
EVEN_SQUARE = 0.03**2
SIGMA_FIELD_SQUARE = 2.0
# The least, of a field that is a little bent everywhere.
SIGMA_FIELD_RAD = 0.005
# A heading whose own sigma is under this (rad) is as good as the field that it was learnt from.
SIGMA_SETTLED_RAD = 0.3
# Without a field for so long (s) it is as good as the gyroscope, which P knows.
ABSENT_S = 2.0


@inlined
def sigma_inclination(params: ConditioningParams, state: ConditioningState) -> float:
    """Angle (rad) that 68 % of the inclination errors lie under.

    A sensor's own, what unsteady force adds, how far levelling has moved the vertical lately,
    which tells a lasting acceleration, and how far the low-passed force has another size than
    gravity: what an accelerometer's error or an acceleration adds along the vertical it adds
    across as well, about both axes. Of slow streams it is the variance that the vertical has by
    its own reckoning.
    """
    signs = state.signs.gravity
    swing_north, swing_east = signs.levelled
    swing = swing_north * swing_north + swing_east * swing_east
    fast = SIGMA_UNSTEADY_RAD**2 * state.gravity.force.unsteady + SIGMA_SWING**2 * swing
    slow = slowness(params, state.coefficients.dt_s)
    fast += SIGMA_UNEVEN_SQUARE * signs.uneven
    known = SIGMA_STEADY_RAD**2 + state.doubt.tilt
    return sqrt(known + (1.0 - slow) * fast + slow * state.tilt.variance)


@inlined
def rival(params: ConditioningParams, state: ConditioningState) -> float:
    """Variance (rad^2) for another heading that may be the right one.

    Before a field is believed that is where it points, as one that looks as expected, or another
    one that lasts; afterwards it is the heading given up.
    """
    signs, reference = state.signs.heading, state.magnetic.reference
    seen_s = reference.other.seen_s
    by_other = 0.0
    if seen_s > 0.0:
        field_6d = rotate(state.gravity.q_6d_g, state.signs.jump.slow)
        north, east = north_east(state.estimate.heading_rad, field_6d)
        by_other = seen_s / (seen_s + reference.borne_s) * atan2(east, north) ** 2
    unborne = 1.0 - signs.borne_s / params.heading_borne_s
    if signs.off_s > 0.0:
        away = atan2(signs.mean_east, signs.mean_north)
        return max(unborne * away * away, by_other)
    away = wrap_angle(signs.other_rad - state.estimate.heading_rad)
    share = max(unborne, STILL_RIVAL) * signs.other_s / OTHER_HEADING_S
    return max(share * away * away, by_other)


@inlined
def sigma_heading(params: ConditioningParams, state: ConditioningState) -> float:
    """Angle (rad) that 68 % of the heading errors lie under.

    The variance P takes the field's error for white, which it is for an uncertain heading. What
    is left of it after long is little beside errors that last: an own field that is not learnt
    yet, steel, a place's gradient, a leaning vertical. They have no model here but are
    measured: by what the field's mean of ``turn_heading_tau_s`` scatters, by how far norm and
    dip are off by more than noise, and by the size of gravity, whose error bends a steep
    field. So P counts as P^2/(P + P_1) only, but for slow streams, whose P is what they miss,
    and without a field.
    """
    p = state.estimate.covariance[9]
    reference = state.magnetic.reference
    h = max(reference.horizontal, LEAST_HORIZONTAL * abs(reference.down))
    steep = (reference.down / h) ** 2 if h > 0.0 else 0.0
    signs = state.signs
    lasting = SIGMA_SCATTER_SQUARE * signs.heading.scatter + rival(params, state)
    bent = steep * (SIGMA_BENT_SQUARE * signs.gravity.uneven + 0.5 * state.doubt.tilt)
    lasting += SIGMA_FIELD_RAD**2 + bent + state.doubt.heading
    bend = max(0.0, reference.uneven - EVEN_SQUARE)
    lasting += SIGMA_FIELD_SQUARE * (1.0 + steep) * bend
    counts = slowness(params, state.coefficients.dt_s)
    counts = max(counts, min(1.0, state.magnetic.wait_s / ABSENT_S))
    own = p * (counts + (1.0 - counts) * p / (p + SIGMA_SETTLED_RAD**2))
    return sqrt(own + lasting)
