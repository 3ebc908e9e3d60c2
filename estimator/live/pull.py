"""How far raw vectors have lately pulled the heading away from the gyroscope.

A magnet that comes slowly leaves e small: the filter follows it. But then it turns against the
gyroscope, freed of the bias that it had before. Which of both is wrong nobody can tell, so the
angle between them counts as an error of the heading.
"""

from math import atan2
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.field.heading import wrap_angle
from estimator.conditioning.times import USUAL_S
from estimator.filter.types import FilterState
from estimator.geometry.quaternion import add, conjugate, exp, multiply, scale, subtract
from estimator.types import ZERO_VEC3, Quaternion, Vec3


class Pull(NamedTuple):
    """What is remembered of the corrections for ``USUAL_S``."""

    heading_rad: float = 0.0  # turned by the vectors, forgotten by and by
    bias_rad_s: Vec3 = ZERO_VEC3  # mean of the filter's: not yet what a magnet makes of it
    seen_s: float = 0.0  # what that is the mean of


NO_PULL = Pull()


@inlined
def pulled(
    pull: Pull, before: Quaternion, state: FilterState, gyr_rad_s: Vec3, error: float, dt_s: float
) -> Pull:
    """The pull with one more sample, from the attitude ``before`` it to that of ``state``.

    ``error`` is the mean e, by which sigma is 2 asin(sqrt(e)). A correction that sigma has
    foretold, as after a wrong start, is no sign of a magnet: it counts by its cosine, 1 - 2 e.
    """
    seen_s = min(pull.seen_s + dt_s, USUAL_S)
    new = subtract(state.gyr_bias_rad_s, pull.bias_rad_s)
    bias = add(pull.bias_rad_s, scale(dt_s / seen_s, new))
    alone = multiply(before, exp(scale(dt_s, subtract(gyr_rad_s, bias))))
    turn_ned = multiply(state.q_ned_frd, conjugate(alone))
    turned = wrap_angle(2.0 * atan2(turn_ned[3], turn_ned[0]))
    surprising = max(0.0, 1.0 - 2.0 * error)
    kept = USUAL_S / (USUAL_S + dt_s)
    return Pull(kept * (pull.heading_rad + surprising * turned), bias, seen_s)
