"""What tells an unsensed turn of the vehicle from noise, acceleration and magnets."""

from math import atan2, exp, pi, sqrt

from estimator.compiled import compiled
from estimator.conditioning.types import (
    BiasState,
    ConditioningParams,
    EventState,
    GravityState,
    MagneticState,
    RestState,
    Smooth,
)
from estimator.quaternion import angle_between_vectors, rotate, scale

HALF_TURN_VARIANCE = pi**2  # after a turn any heading is possible
# Heading already this uncertain (rad, sigma) needs no event to move.
UNKNOWN_HEADING_SIGMA = pi / 2.0


@compiled
def heading_turned(
    params: ConditioningParams,
    state: EventState,
    bias: BiasState,
    field: MagneticState,
    north: float,
    east: float,
    dt_s: float,
) -> float:
    """How long (s) an undisturbed-looking field has pointed far from north."""
    known = bias.covariance[9] < UNKNOWN_HEADING_SIGMA**2
    far = abs(atan2(east, north)) > params.turn_heading_rad
    if known and far and field.confidence > params.turn_confidence:
        return state.heading_s + dt_s
    return 0.0


@compiled
def gravity_turned(
    params: ConditioningParams,
    state: EventState,
    rest: RestState,
    gravity: GravityState,
    dt_s: float,
) -> float:
    """How long (s) a quiet vehicle has felt gravity elsewhere than G has it."""
    if not rest.quiet:
        return 0.0
    now = rotate(gravity.q_g_frd, scale(-1.0, rest.acc.value))
    if angle_between_vectors(now, gravity.down.value) > params.turn_quiet_rad:
        return state.quiet_s + dt_s
    return 0.0


@compiled
def reseeded(gravity: GravityState, rest: RestState) -> GravityState:
    """The low-pass in G started anew from the quiet vehicle's gravity."""
    now = rotate(gravity.q_g_frd, scale(-1.0, rest.acc.value))
    return GravityState(
        gravity.q_g_frd, gravity.q_6d_g, Smooth(now, (0.0, 0.0, 0.0)), (0.0, 0.0), gravity.age_s
    )


@compiled
def levelled(
    params: ConditioningParams, state: EventState, gravity: GravityState, dt_s: float
) -> tuple[float, float]:
    """Leaky sum (rad) of the levelling, whose shortest way is not the turn's own."""
    decay = exp(-dt_s / params.turn_levelling_tau_s)
    rate = gravity.levelling_rate_rad_s
    return (
        decay * state.levelled[0] + dt_s * rate[0],
        decay * state.levelled[1] + dt_s * rate[1],
    )


@compiled
def size(v: tuple[float, float]) -> float:
    """Length of a horizontal vector."""
    return sqrt(v[0] * v[0] + v[1] * v[1])


@compiled
def heading_forgotten(state: BiasState) -> BiasState:
    """The heading's variance raised by half a turn's square: the next residuals set it."""
    p = state.covariance
    return BiasState(
        state.bias_rad_s,
        state.heading_rad,
        (p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9] + HALF_TURN_VARIANCE),
        state.rows,
        state.rows_slope,
        state.drift,
        state.drift_slope,
    )
