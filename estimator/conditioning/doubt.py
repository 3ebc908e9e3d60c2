"""What an unsensed turn leaves to be found anew: the vertical by the force, then the heading."""

from math import asin, atan2, sin, sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import (
    ConditioningParams,
    Doubt,
    Estimate,
    FieldBefore,
    JumpSigns,
    MagneticState,
    TurnSigns,
    Two,
)
from estimator.conditioning.unsensed_turn import (
    HALF_TURN_VARIANCE,
    LONGEST_SIGN_S,
    doubt_heading,
)

# The least error of a second's mean force, rad^2, of an accelerometer at rest.
LEAST_WANDER = 0.009**2
# The share of a turn that its jump shows, and what noise adds to either (rad).
SUDDEN_SHARE = 0.85
SUDDEN_RAD = 0.05


@inlined
def doubt_tilt(doubt: Doubt, variance: float) -> Doubt:
    """More of it about the vertical."""
    tilt = min(doubt.tilt + variance, HALF_TURN_VARIANCE)
    return Doubt(tilt, doubt.heading, doubt.usual_s, doubt.before)


@inlined
def raise_doubt(doubt: Doubt, signs: TurnSigns, variance: float, steepness: float) -> Doubt:
    """After a turn by an angle of that variance: of the vertical, and of a heading by the field."""
    is_first = doubt.heading == 0.0
    before = FieldBefore(signs.jump.slow_norm, signs.heading.mean_confidence)
    return Doubt(
        tilt=min(doubt.tilt + variance, HALF_TURN_VARIANCE),
        heading=min(doubt.heading + variance * (1.0 + steepness), HALF_TURN_VARIANCE),
        usual_s=0.0,
        before=before if is_first else doubt.before,
    )


@inlined
def steepness_of(field: MagneticState) -> float:
    """Squared tangent of the dip: a tilt of the vertical bends the heading by the tangent."""
    reference = field.reference
    h = max(reference.horizontal, 0.1 * abs(reference.down))
    return (reference.down / h) ** 2 if h > 0.0 else 0.0


@inlined
def share_of_force(
    params: ConditioningParams, doubt: Doubt, wander: float, dt_s: float
) -> tuple[Doubt, float]:
    """A Kalman filter's share of the next reading of the force, and the doubt that is left.

    ``wander`` is how far the mean of ``turn_moving_tau_s`` usually is off, so a reading's
    noise, were it white, is R = wander 2 tau/dt: it holds for a hand's quick accelerations and
    a vehicle's slow ones alike. K = D/(D + R), D <- (1 - K) D.
    """
    noise = (wander + LEAST_WANDER) * 2.0 * params.turn_moving_tau_s / dt_s
    share = doubt.tilt / (doubt.tilt + noise)
    if share <= dt_s / params.gravity_tau_s:  # the low-pass is as quick
        return Doubt(0.0, doubt.heading, doubt.usual_s, doubt.before), 0.0
    return Doubt((1.0 - share) * doubt.tilt, doubt.heading, doubt.usual_s, doubt.before), share


@inlined
def is_sudden(variance: float, field: MagneticState, horizontal: Two) -> bool:
    """Whether most of the angle by which the field is off by now came in the jump at once.

    A magnet that passes takes its time. A heading off by h turns a field of dip d by
    2 asin(cos d sin h/2).
    """
    steepness = steepness_of(field)
    off = abs(atan2(horizontal[1], horizontal[0]))
    turned = 2.0 * asin(sin(0.5 * off) / sqrt(1.0 + steepness))
    return SUDDEN_SHARE * turned - SUDDEN_RAD < sqrt(variance / (1.0 + steepness))


@inlined
def release_doubt(
    params: ConditioningParams,
    doubt: Doubt,
    estimate: Estimate,
    field: MagneticState,
    jump: JumpSigns,
    horizontal: Two,
    dt_s: float,
) -> tuple[Doubt, Estimate, bool]:
    """Hand the heading its doubt once the field has looked as usual for a while.

    A magnet that has turned the field shows in norm or dip, now or soon, and must not draw the
    heading: the field has to stand still again, and nothing is left of either doubt if its norm
    is another. And a heading by the field is never better than the vertical it was taken with.
    """
    usual = field.look.confidence > params.turn_confidence * doubt.before.confidence
    still = jump.apart_rad < params.turn_jump_rad
    step_s = min(dt_s, LONGEST_SIGN_S)
    usual_s = max(0.0, doubt.usual_s + (step_s if usual and still else -step_s))
    most = params.turn_jump_norm + sqrt(field.reference.uneven)
    if doubt.heading > 0.0 and abs(jump.quick_norm - doubt.before.norm) > most * doubt.before.norm:
        return Doubt(0.0, 0.0, usual_s, doubt.before), estimate, False
    left = doubt.heading
    if usual_s <= params.turn_jump_time_s:
        return Doubt(doubt.tilt, left, usual_s, doubt.before), estimate, False
    if not is_sudden(left, field, horizontal):
        left = 0.0
    now = estimate.covariance[9]
    raised = max(now + left, 0.5 * doubt.tilt * steepness_of(field)) - now
    return (
        Doubt(doubt.tilt, 0.0, usual_s, doubt.before),
        doubt_heading(estimate, raised),
        left > 0.0,
    )
