"""Rest: gyroscope and accelerometer stay near their own low-pass, in the mean of half a second."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import QUICK_S
from estimator.conditioning.vertical.lowpass import LowPass, Smooth, smooth
from estimator.geometry.quaternion import square, subtract
from estimator.types import Vec3


class RestState(NamedTuple):
    """Whether the vehicle has been quiet for ``rest_time_s``, and whether it rests."""

    gyr: Smooth = Smooth()  # rad/s, FRD
    acc: Smooth = Smooth()  # m/s^2, FRD
    gyr_square: float = 0.0  # mean square of the distance from it, (rad/s)^2
    acc_square: float = 0.0  # the same, (m/s^2)^2
    quiet_s: float = 0.0  # for how long both have been near their low-pass
    steady: bool = False  # whether that is long enough for a rest, or for a steady turn
    resting: bool = False  # whether it is a rest


@inlined
def observe_rest(
    params: ConditioningParams, k: LowPass, state: RestState, gyr: Vec3, acc: Vec3, dt_s: float
) -> RestState:
    """Decide whether the vehicle is quiet, and whether it has been for long enough to rest.

    Quiet: the root mean square of a - a_lp under its threshold, that of g - g_lp under the largest
    usual bias; at rest every rate is, too, after VQF (Laidig and Seel 2023,
    doi 10.1016/j.inffus.2022.10.014). Idling rotors shake single samples further.
    The samples are compared with the low-pass before it takes them, so that
    the test keeps its meaning at a few samples a second. A vehicle turning
    steadily and slower than that looks the same, and one that rests with a poor gyroscope as if it
    turned: gravity and field tell (:mod:`estimator.conditioning.vertical.stillness`).
    """
    limit = params.bias_limit_rad_s
    share = dt_s / (QUICK_S + dt_s)
    gyr_square = state.gyr_square
    gyr_square += share * (square(subtract(gyr, state.gyr.value)) - gyr_square)
    acc_square = state.acc_square
    acc_square += share * (square(subtract(acc, state.acc.value)) - acc_square)
    steady_gyr, steady_acc = gyr_square < limit * limit, acc_square < params.rest_acc_m_s2**2
    gyr_smooth = smooth(k, state.gyr, gyr)
    g = gyr_smooth.value
    slow = abs(g[0]) < limit and abs(g[1]) < limit and abs(g[2]) < limit
    quiet_s = min(state.quiet_s + dt_s, 1e6) if steady_gyr and steady_acc else 0.0
    steady = quiet_s >= params.rest_time_s
    return RestState(
        gyr=gyr_smooth,
        acc=smooth(k, state.acc, acc),
        gyr_square=gyr_square,
        acc_square=acc_square,
        quiet_s=quiet_s,
        steady=steady,
        resting=steady and slow,
    )


@inlined
def initial_rest(gyr: Vec3, acc: Vec3) -> RestState:
    """The state at the first reading, where both low-passes begin."""
    zero = (0.0, 0.0, 0.0)
    return RestState(Smooth(gyr, zero), Smooth(acc, zero), 0.0, 0.0, 0.0, False, False)
