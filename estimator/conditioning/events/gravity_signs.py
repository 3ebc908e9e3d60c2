"""Gravity that keeps pulling elsewhere than the low-passed one: a turn about a level axis."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.events.duration import duration_s
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.rest import RestState
from estimator.geometry.quaternion import angle_between_vectors, norm, rotate, scale, square
from estimator.types import STANDARD_GRAVITY_M_S2, Vec2, Vec3

# If the quickly followed force is less than this share of the slow one, the vehicle falls or is
# in the middle of a turn: the force has no direction to compare.
LEAST_GRAVITY_SHARE = 0.4
# Before anything is known: accelerations that tilt the mean force of a second by ten degrees.
UNKNOWN_WANDER = 0.03
# Averaging (s) of how far a second's mean force usually is off the vertical.
WANDER_TAU_S = 10.0
# Averaging (s) of how far the low-passed force has another size than gravity, and points
# elsewhere than its own long mean.
UNEVEN_TAU_S = 15.0


class GravitySigns(NamedTuple):
    """What the specific force says about an unsensed turn about a level axis."""

    quiet_s: float = 0.0  # for how long a quiet vehicle's gravity has been off
    moving_s: float = 0.0  # for how long that of a moving vehicle has
    levelled: Vec2 = (0.0, 0.0)  # what levelling has turned lately about north and east, rad
    wander: float = UNKNOWN_WANDER  # mean square angle between quick and slow gravity, rad^2
    apart: float = 0.0  # mean square angle between published gravity and its long mean, rad^2
    uneven: float = 0.0  # mean square of how far the size of gravity is off, as a share


with_times = replacer(GravitySigns, "quiet_s", "moving_s", "levelled")


@inlined
def gravity_at_rest(rest: RestState, gravity: GravityState) -> Vec3:
    """A quiet vehicle's gravity in G."""
    return rotate(gravity.q_g_frd, scale(-1.0, rest.acc.value))


@inlined
def watch_gravity(
    params: ConditioningParams,
    state: GravitySigns,
    rest: RestState,
    gravity: GravityState,
    step: Vec2,
    decay: float,
    dt_s: float,
    doubt: float,
    weighed: float,
) -> GravitySigns:
    """Look for gravity that keeps pulling elsewhere than the low-passed one in G.

    A quiet vehicle's gravity is known at once. Accelerations of a moving one
    reverse within a second or two and rarely exceed 1 g, a turn stays. And a
    levelling of many degrees has turned about the axis that was shortest, not
    the one the vehicle turned about, so its heading is wrong. A moving vehicle's vertical that is
    ``weighed`` has a variance that says how far to believe the force.
    """
    f = gravity.force.down.value
    quiet = False
    if rest.quiet:
        quiet = angle_between_vectors(gravity_at_rest(rest, gravity), f) > params.turn_quiet_rad
    quick = gravity.force.quick
    falls = square(quick) <= LEAST_GRAVITY_SHARE**2 * square(f)
    off = 0.0 if falls else angle_between_vectors(quick, f)
    moving = weighed == 0.0 and off > params.turn_moving_rad
    a = dt_s / (WANDER_TAU_S + dt_s) if doubt == 0.0 else 0.0
    lag = angle_between_vectors(gravity.force.best.value, gravity.force.long)
    size = norm(f) / STANDARD_GRAVITY_M_S2 - 1.0
    b = dt_s / (min(UNEVEN_TAU_S, gravity.force.age_s) + dt_s)
    return GravitySigns(
        quiet_s=duration_s(quiet, state.quiet_s, dt_s),
        moving_s=duration_s(moving, state.moving_s, dt_s),
        levelled=(decay * state.levelled[0] + step[0], decay * state.levelled[1] + step[1]),
        wander=state.wander + a * (off * off - state.wander),
        apart=state.apart + b * (lag * lag - state.apart),
        uneven=state.uneven + b * (size * size - state.uneven),
    )
