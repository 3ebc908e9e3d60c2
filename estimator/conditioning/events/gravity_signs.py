"""Gravity that keeps pulling elsewhere than the low-passed one: a turn about a level axis."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.events.heading_signs import duration_s
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.robust import MOST_DEVIATION
from estimator.conditioning.times import LATELY_S
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.lasting import PRIOR_VARIANCE
from estimator.geometry.quaternion import angle_between_vectors, norm, square
from estimator.types import STANDARD_GRAVITY_M_S2


class GravitySigns(NamedTuple):
    """What the specific force says about an unsensed turn about a level axis."""

    off_s: float = 0.0  # for how long gravity has pulled elsewhere
    force_scatter: float = PRIOR_VARIANCE  # mean square angle between quick and slow gravity, rad^2
    apart: float = 0.0  # mean square angle between published gravity and its long mean, rad^2
    uneven: float = 0.0  # mean square of how far the size of gravity is off, as a share


with_time = replacer(GravitySigns, "off_s")


@inlined
def watch_gravity(
    params: ConditioningParams,
    state: GravitySigns,
    gravity: GravityState,
    dt_s: float,
    inflation: float,
    weighed: float,
) -> GravitySigns:
    """Look for gravity that keeps pulling elsewhere than the low-passed one in G.

    Accelerations reverse within a second or two and rarely exceed 1 g, a turn stays. A vertical
    that is ``weighed`` has a variance that says how far to believe the force.
    """
    f = gravity.force.down.value
    quick = gravity.force.quick
    # Falling, or in the middle of a turn, the force has no direction to compare.
    falls = square(quick) <= (1.0 - MOST_DEVIATION) ** 2 * square(f)
    off = 0.0 if falls else angle_between_vectors(quick, f)
    elsewhere = weighed == 0.0 and off > params.turn_moving_rad
    a = dt_s / (LATELY_S + dt_s) if inflation == 0.0 else 0.0
    lag = angle_between_vectors(gravity.force.best.value, gravity.force.long)
    size = norm(f) / STANDARD_GRAVITY_M_S2 - 1.0
    b = dt_s / (min(LATELY_S, gravity.force.age_s) + dt_s)
    return GravitySigns(
        off_s=duration_s(elsewhere, state.off_s, dt_s),
        force_scatter=state.force_scatter + a * (off * off - state.force_scatter),
        apart=state.apart + b * (lag * lag - state.apart),
        uneven=state.uneven + b * (size * size - state.uneven),
    )
