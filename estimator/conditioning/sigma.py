"""How sure the directions are: confidences, and angles that 68 % of errors lie under."""

from math import atan2, inf, sqrt
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.events.jump_signs import turn_of
from estimator.conditioning.events.step import EventsState, States
from estimator.conditioning.field.calibration import own_field
from estimator.conditioning.field.magnetic import MagneticState, has_heading, steepness
from estimator.conditioning.field.step import north_east, wrap_angle
from estimator.conditioning.params import CONFIRM_S, LONG_S, SPAN_S, USUAL_S, ConditioningParams
from estimator.conditioning.vertical.bias import SETTLED_HEADING_RAD
from estimator.conditioning.vertical.gravity import heading_frame, lag_square
from estimator.conditioning.vertical.slow_acceleration import SCALE_ERROR
from estimator.conditioning.vertical.step import VerticalState
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.conditioning.vertical.tilt import slowness, weighing
from estimator.geometry.quaternion import rotate

# Variance by a measured mean square: of the inclination by that of the force's relative size, of
# the heading by that of the field's scatter, and of its norm and dip.
MEASURED_SQUARE = 2.0
# What a low-pass leaves of the variance of a mean over a window, or by slow accelerations.
LOW_PASS_SHARE = 0.5
# The share that counts, beside what is measured, of the variance that a vehicle's vertical is
# reckoned to have, and of the squared angle between the force of a second and the vertical: for
# some seconds nothing shows whether that is an acceleration or an error.
UNMEASURED_SHARE = 0.1
# The share by which a heading given up may still be right once another is confirmed.
LEAST_ALTERNATIVE = 0.15


class Certainty(NamedTuple):
    """How sure the vectors are, and how well inclination and heading are known."""

    has_heading: bool = False  # whether a field has shown it
    gravity_confidence: float = 0.0  # 0..1, falls with accelerations
    magnetic_confidence: float = 0.0  # 0..1, of the present field; 0 without one
    sigma_inclination_rad: float = 0.0  # angle that 68 % of the errors lie under
    sigma_brief_rad: float = 0.0  # the same if no acceleration lasted
    sigma_heading_rad: float = inf  # angle that 68 % of the errors lie under, if there is a heading


@inlined
def certainty_of(params: ConditioningParams, now: States) -> Certainty:
    """The certainty after a learning step; until the next one nothing changes it."""
    vertical, (_, magnetic), events = now
    known = has_heading(magnetic)
    return Certainty(
        has_heading=known,
        gravity_confidence=1.0 / (1.0 + events.gravity.force_scatter),
        magnetic_confidence=magnetic.look.confidence if magnetic.wait_s < SPAN_S else 0.0,
        sigma_inclination_rad=sigma_inclination(params, vertical, events, vertical.tilt.variance),
        sigma_brief_rad=sigma_inclination(params, vertical, events, vertical.tilt.fresh),
        sigma_heading_rad=sigma_heading(params, now) if known else inf,
    )


@inlined
def sigma_inclination(
    params: ConditioningParams, vertical: VerticalState, events: EventsState, reckoned: float
) -> float:
    """Angle (rad) that 68 % of the inclination errors lie under.

    It adds the sensor's own error, how far the low-passed force differs in size from gravity (an
    error along the vertical is as large across it), and the larger of two measures of slow
    accelerations and drift: the variance that chose the averaging time, and how far the vertical
    lies off its own longer mean. Slow streams count the variance ``reckoned`` (rad^2) by the
    vertical itself instead. Vehicles come to rest again, so their accelerations cancel sooner than
    white noise: a share of it counts, and how far the force of the last ``USUAL_S``, and of the
    last second, is off the vertical.
    """
    signs, dt_s = events.gravity, vertical.coefficients.dt_s
    slow, weighed = slowness(params, dt_s), weighing(params, dt_s)
    measured = max(signs.apart, LOW_PASS_SHARE * vertical.averaging.variance)
    measured += MEASURED_SQUARE * signs.uneven + signs.unusual
    known = LEAST_DIRECTION_RAD**2 + vertical.inflation
    force = vertical.gravity.force
    carried = lag_square(force) + carried_share(vertical) * reckoned
    carried += UNMEASURED_SHARE * turn_of(force.quick, force.best.value) ** 2
    return sqrt(known + (1.0 - weighed) * measured + slow * reckoned + (weighed - slow) * carried)


@inlined
def carried_share(vertical: VerticalState) -> float:
    """The share that counts of a vehicle's reckoned variance, more while the mean force is new."""
    unseen = 1.0 - vertical.gravity.force.age_s / USUAL_S
    return max(UNMEASURED_SHARE, LOW_PASS_SHARE * unseen)


@inlined
def alternative(vertical: VerticalState, magnetic: MagneticState, events: EventsState) -> float:
    """Variance (rad^2) for another heading that may be the right one.

    Before a field is confirmed that is where it points, or where another constant field does;
    afterwards it is the heading that was given up.
    """
    signs, reference = events.heading, magnetic.reference
    heading_rad, seen_s = vertical.estimate.heading_rad, reference.other.seen_s
    by_other = 0.0
    if seen_s > 0.0:
        frame = heading_frame(vertical.gravity, vertical.averaging.share)
        field_6d = rotate(frame, events.jump.slow)
        north, east = north_east(heading_rad, field_6d)
        by_other = seen_s / (seen_s + reference.confirmed_s) * atan2(east, north) ** 2
    unconfirmed = 1.0 - signs.confirmed_s / CONFIRM_S
    away = atan2(signs.mean_east, signs.mean_north)
    by_other = max(unconfirmed * away * away, by_other)
    away = wrap_angle(signs.other_rad - heading_rad)
    share = max(unconfirmed, LEAST_ALTERNATIVE) * signs.other_s / LONG_S
    return max(share * away * away, by_other)


@inlined
def sigma_heading(params: ConditioningParams, now: States) -> float:
    """Angle (rad) that 68 % of the heading errors lie under.

    The variance P takes the field's error for white. In the long run P is little beside errors that
    last: an own field not learnt yet, steel, a tilted vertical. The scatter of the field's mean of
    ``SPAN_S``, norm and dip, and the size of gravity measure them. So P counts as P^2/(P + P_1),
    except for slow streams, whose P is what they miss, and without a field.
    """
    vertical, (calibration, magnetic), events = now
    p = vertical.estimate.covariance[9]
    steep = steepness(magnetic.reference)
    constant = MEASURED_SQUARE * events.heading.scatter + alternative(vertical, magnetic, events)
    dt_s = vertical.coefficients.dt_s
    slow = slowness(params, dt_s)
    tilt_variance = (
        lag_square(vertical.gravity.force)
        + vertical.inflation
        + (weighing(params, dt_s) - slow) * carried_share(vertical) * vertical.tilt.variance
    )
    by_tilt = 0.5 * steep * (events.gravity.uneven + tilt_variance)
    constant += LEAST_DIRECTION_RAD**2 + by_tilt + events.inflation.variance
    uneven = max(0.0, magnetic.reference.uneven - SCALE_ERROR**2)
    _, own_left = own_field(calibration.learnt)
    constant += (1.0 + steep) * (MEASURED_SQUARE * uneven + 0.5 * own_left)
    counts = max(slow, min(1.0, magnetic.wait_s / SPAN_S))
    own = p * (counts + (1.0 - counts) * p / (p + SETTLED_HEADING_RAD**2))
    return sqrt(own + constant)
