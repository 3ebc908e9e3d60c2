"""How well an estimate predicts its own vectors by the gyroscope alone: a cost without truth.

From each sample on, the attitude is turned for half a second by the gyroscope less the estimated
bias, and gravity and north as they then should be are compared with what is measured. An attitude
or a bias that is off is off in its prediction, too.
"""

from math import atan2, pi

import numpy as np

from estimator.arrays import Floats
from estimator.compilation.compiled import compiled, types_of
from estimator.geometry.quaternion import exp, multiply, normalize, rotate, unit
from estimator.live.rows import Rows

AHEAD_S = 0.5
# A prediction over a longer silence shows of the silence.
LONGEST_S = 1.5


_EXAMPLE = Rows(np.zeros(1, np.int64), *(np.zeros((1, 3)),) * 3, np.zeros(1, np.bool_))


@compiled(types=lambda: types_of(_EXAMPLE, np.zeros((1, 4)), np.zeros((1, 3)), 0))
def predicted_vectors(
    rows: Rows, q_ned_frd: Floats, bias_rad_s: Floats, first: int
) -> tuple[Floats, Floats]:
    """Minus the force, and the field, in NED by the prediction that ends at each sample.

    Unit vectors (N, 3), not numbers where there is no prediction or no field. Predictions begin
    at sample ``first`` or later.
    """
    times_us, gyr, acc, mag, has_mag = rows
    time_s = 1e-6 * (times_us - times_us[0])
    n = len(time_s)
    down, field = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    for k in range(first, n):
        q = (q_ned_frd[k, 0], q_ned_frd[k, 1], q_ned_frd[k, 2], q_ned_frd[k, 3])
        j = k
        while j + 1 < n and time_s[j] - time_s[k] < AHEAD_S - 1e-6:
            j += 1
            dt = time_s[j] - time_s[j - 1]
            turn = (
                (gyr[j, 0] - bias_rad_s[k, 0]) * dt,
                (gyr[j, 1] - bias_rad_s[k, 1]) * dt,
                (gyr[j, 2] - bias_rad_s[k, 2]) * dt,
            )
            q = multiply(q, exp(turn))
        ahead_s = time_s[j] - time_s[k]
        if ahead_s < AHEAD_S - 1e-6 or ahead_s > LONGEST_S:
            continue
        q = normalize(q)
        g = rotate(q, unit((-acc[j, 0], -acc[j, 1], -acc[j, 2])))
        down[j, 0], down[j, 1], down[j, 2] = g
        if has_mag[j]:
            m = rotate(q, unit((mag[j, 0], mag[j, 1], mag[j, 2])))
            field[j, 0], field[j, 1], field[j, 2] = m
    return down, field


def heading_errors(field: Floats) -> Floats:
    """Angle (N,) of the field's horizontal part from its mean direction, rad.

    Where north is does not matter: only that it stays.
    """
    angles = np.arctan2(field[:, 1], field[:, 0])
    seen = angles[np.isfinite(angles)]
    mean = atan2(float(np.sin(seen).sum()), float(np.cos(seen).sum())) if len(seen) else 0.0
    return np.asarray(np.abs((angles - mean + pi) % (2.0 * pi) - pi))
