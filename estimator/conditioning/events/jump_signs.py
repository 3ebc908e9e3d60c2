"""The field in G, where it stands still: what turns it there at once is an unsensed turn."""

from math import sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.calibration import Calibration
from estimator.conditioning.field.magnetic import MOST_DISTORTION
from estimator.conditioning.params import FAR, LATELY_S, LONG_S, QUICK_S, ConditioningParams
from estimator.conditioning.vertical.lowpass import approach, largest_between
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.geometry.quaternion import angle_between_vectors, norm, square
from estimator.types import ZERO_VEC3, Vec2, Vec3

# The two low-passes of the field in G, s.
JUMP_QUICK_S = 0.1
# The largest part of a jump that lies between the two.
JUMP_SHARE = largest_between(JUMP_QUICK_S, QUICK_S)
# In how far they differ usually a moment counts as no more than so many times that, and noise: a
# jump is not usual because it has come, and teaches no calibration.
MOST_USUAL = 2.5


class JumpSigns(NamedTuple):
    """Whether the field turns in G, where it stands still."""

    quick: Vec3 = ZERO_VEC3  # the field in G, low-passed a little, in its own unit
    slow: Vec3 = ZERO_VEC3  # the field in G, low-passed more
    quick_norm: float = 0.0  # its norm, low-passed as ``quick``: a mean of directions is shorter
    slow_norm: float = 0.0  # its norm, low-passed as ``slow``
    stretched: float = 0.0  # mean square of how far the two differ, as a share
    apart_rad: float = 0.0  # angle between the two
    moves_rad: float = 0.0  # angle between the last reading and the first of them
    scatter: float = 0.0  # mean square of that angle, rad^2
    since_leap_s: float = LONG_S  # since that has grown at once
    usual: float = 0.0  # mean square of ``apart_rad``
    usual_turning: float = 0.0  # mean square rate of the vehicle meanwhile, (rad/s)^2
    turning: float = 0.0  # mean square rate of the vehicle lately, (rad/s)^2
    unseen: float = 0.0  # variance of turns missed between samples lately, rad^2
    seen_rad: float = 0.0  # largest angle of the jump that has counted; pi: it is a magnet's
    age_s: float = 0.0  # since the first field


@inlined
def watch_field(
    params: ConditioningParams,
    state: JumpSigns,
    field_g: Vec3,
    turning: float,
    unseen: float,
    dt_s: float,
) -> JumpSigns:
    """Follow the field in G twice, quickly and slowly, and how far the two usually differ.

    Whatever the vehicle does, the field of a place stands still in G; beside steel it changes by a
    few degrees a second. A turn that the gyroscope has not shown turns it at once.
    """
    n = norm(field_g)
    a, b = dt_s / (JUMP_QUICK_S + dt_s), dt_s / (QUICK_S + dt_s)
    if state.age_s == 0.0:
        b = 1.0
    # a spike, or a magnet, shows no turn: both low-passes take it slowly, so that they part no
    # further, and follow a field that stays another
    if abs(n - state.slow_norm) > MOST_DISTORTION * state.slow_norm:
        a = b
    quick = approach(state.quick, field_g, a)
    slow = approach(state.slow, field_g, b)
    quick_norm = state.quick_norm + a * (n - state.quick_norm)
    slow_norm = state.slow_norm + b * (n - state.slow_norm)
    stretched = (quick_norm / max(slow_norm, TINY) - 1.0) ** 2
    c = dt_s / (min(LATELY_S, state.age_s) + dt_s)
    apart_rad = turn_of(quick, slow)
    apart = apart_rad**2
    if state.age_s > LATELY_S:
        apart = min(apart, MOST_USUAL**2 * (state.usual + LEAST_DIRECTION_RAD**2))
    moves_rad = turn_of(state.quick, field_g)
    turning_lately = max(turning, state.turning + b * (turning - state.turning))
    # A field that goes along turns in G by twice the vehicle's turn at most.
    least = params.turn_jump_rad**2 + FAR * (state.scatter + state.unseen + unseen)
    least += 4.0 * turning_lately * dt_s**2
    leaps = moves_rad > state.moves_rad + sqrt(least)
    scatter = min(moves_rad**2, MOST_USUAL**2 * (state.scatter + LEAST_DIRECTION_RAD**2))
    return state._replace(
        quick=quick,
        slow=slow,
        quick_norm=quick_norm,
        slow_norm=slow_norm,
        stretched=state.stretched + b * (stretched - state.stretched),
        apart_rad=apart_rad,
        moves_rad=moves_rad,
        scatter=state.scatter + c * (scatter - state.scatter),
        since_leap_s=0.0 if leaps else min(state.since_leap_s + dt_s, LONG_S),
        usual=state.usual + c * (apart - state.usual),
        usual_turning=state.usual_turning + c * (turning - state.usual_turning),
        turning=turning_lately,
        unseen=(1.0 - b) * state.unseen + unseen,
        age_s=min(state.age_s + dt_s, 1e6),
    )


@inlined
def turn_of(u: Vec3, v: Vec3) -> float:
    """The angle between two vectors, rad; 0 where one has no direction."""
    return angle_between_vectors(u, v) if square(u) > 0.0 and square(v) > 0.0 else 0.0


@inlined
def jump_variance(params: ConditioningParams, state: JumpSigns, learnt: Calibration) -> Vec2:
    """Variance (rad^2) of the turn that the field's jump shows, and the angle (rad) counted by now.

    A jump is more than noise, than what the field usually does here, than what an unknown lag
    and own field make of turning, and than what slow samples miss. A magnet that turns the
    field changes its norm, too: by how much it does is no sign of a turn.
    """
    p, turned = learnt.covariance, state.apart_rad
    own = p[9] + QUICK_S**2 * (p[0] + p[4] + p[7])
    least = params.turn_jump_rad**2 + FAR * (state.usual + state.unseen + state.stretched)
    more = max(0.0, state.turning - state.usual_turning)
    by_turning = own * state.turning
    if state.usual_turning > 0.0:
        by_turning = min(by_turning, FAR * state.usual * more / state.usual_turning)
    least += by_turning
    if turned**2 < 0.25 * least:
        return 0.0, 0.0
    if turned**2 < least or turned <= state.seen_rad:
        return 0.0, state.seen_rad
    return (turned**2 - state.seen_rad**2) / JUMP_SHARE**2, turned


@inlined
def looks_turned(params: ConditioningParams, state: JumpSigns) -> bool:
    """Whether the field in G turns more than it usually does.

    What an unknown lag or own field makes of turning is part of the usual. What has jumped would
    pass for the vehicle's own field along an axis that is still unknown.
    """
    least = params.turn_jump_rad**2 + MOST_USUAL**2 * (state.usual + state.unseen)
    return state.apart_rad**2 > least
