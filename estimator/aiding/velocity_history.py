"""What the vehicle has gained in velocity over the last half second, for reports that come late.

Rows of (time, velocity gained since the beginning, acceleration), the newest first; in NED.
A row is kept every ``STEP_S`` or at each sample if those are slower; the newest is always there.
"""

from itertools import accumulate

import numpy as np

from estimator.aiding.covariance import part
from estimator.aiding.types import Array
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.gather import STEP_S
from estimator.conditioning.params import LONG_S
from estimator.geometry.quaternion import add, scale, subtract
from estimator.types import Vec3

ROWS = 32  # with ``STEP_S`` 0.6 s
OLDEST_S = ROWS * STEP_S  # how far back it goes at least: older reports come too late
WIDTHS = {"time": 1, "gained": 3, "acceleration": 3}
TIME, GAINED, ACCELERATION, COLUMNS = accumulate(WIDTHS.values(), initial=0)


def new_velocity_history(acceleration: Vec3) -> Array:
    """(ROWS, COLUMNS) before the first step: nothing has been gained."""
    velocity_history = np.zeros((ROWS, COLUMNS))
    velocity_history[1:, TIME] = -LONG_S - np.arange(1, ROWS)  # nothing is known before
    velocity_history[:, ACCELERATION : ACCELERATION + 3] = acceleration
    return velocity_history


@inlined
def extend_velocity_history(before: Array, gained: Vec3, acceleration: Vec3, dt: float) -> Array:
    """A new velocity history with one more sample."""
    new = before.copy()
    if before[0, TIME] - before[1, TIME] >= STEP_S:
        new[1:] = before[:-1]
    new[0, TIME] = before[0, TIME] + dt
    for i in range(3):
        new[0, GAINED + i] = before[0, GAINED + i] + gained[i]
        new[0, ACCELERATION + i] = acceleration[i]
    return new


@inlined
def look_back(velocity_history: Array, ago_s: float) -> tuple[Vec3, Vec3]:
    """The velocity gained since ``ago_s`` before the newest sample, and the acceleration then.

    That moment is ahead of the sample if ``ago_s`` is negative. The acceleration is linear between
    two rows and stays what it was outside.
    """
    then = velocity_history[0, TIME] - ago_s
    newest = part(velocity_history[0], ACCELERATION)
    if ago_s <= 0.0:
        return scale(ago_s, newest), newest
    k = 0
    while k < ROWS - 2 and velocity_history[k + 1, TIME] > then:
        k += 1
    after = part(velocity_history[k], ACCELERATION)
    before = part(velocity_history[k + 1], ACCELERATION)
    back = velocity_history[k, TIME] - then
    gained = subtract(part(velocity_history[0], GAINED), part(velocity_history[k], GAINED))
    step = velocity_history[k, TIME] - velocity_history[k + 1, TIME]
    if step > LONG_S or back > (1.0 + TINY) * step:  # the history does not go back that far
        return add(gained, scale(back, after)), after
    change = scale(back / step, subtract(before, after))
    return add(gained, scale(back, add(after, scale(0.5, change)))), add(after, change)
