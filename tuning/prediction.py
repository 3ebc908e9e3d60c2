"""How well an estimate predicts its own vectors by the gyroscope alone: a cost without truth.

From each sample on, the attitude is turned for half a second by the gyroscope less the estimated
bias, and gravity and north as they then should be are compared with what is measured. An attitude
or a bias that is off is off in its prediction, too.
"""

from math import atan2

import numpy as np

from estimator.compilation.compiled import compiled, types_of
from estimator.geometry.quaternion import exp, multiply, normalize, rotate, scale, subtract, unit
from estimator.geometry.rotations import wrap
from estimator.live.rows import NO_ROWS, Rows, reading_of
from estimator.types import Floats

AHEAD_S = 0.5
# A prediction over a longer silence shows of the silence.
LONGEST_S = 1.5


@compiled(types=lambda: types_of(NO_ROWS, np.zeros((1, 4)), np.zeros((1, 3)), 0))
def predicted_vectors(
    rows: Rows, q_ned_frd: Floats, bias_rad_s: Floats, first: int
) -> tuple[Floats, Floats]:
    """Minus the force, and the field, in NED by the prediction that ends at each sample.

    Unit vectors (N, 3), not numbers where there is no prediction or no field. Predictions begin
    at sample ``first`` or later.
    """
    time_s = 1e-6 * (rows.times_us - rows.times_us[0])
    n = len(time_s)
    down, field = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    for k in range(first, n):
        q = (q_ned_frd[k, 0], q_ned_frd[k, 1], q_ned_frd[k, 2], q_ned_frd[k, 3])
        bias = (bias_rad_s[k, 0], bias_rad_s[k, 1], bias_rad_s[k, 2])
        j = k
        while j + 1 < n and time_s[j] - time_s[k] < AHEAD_S - 1e-6:
            j += 1
            gyr = reading_of(rows, j)[1]
            q = multiply(q, exp(scale(time_s[j] - time_s[j - 1], subtract(gyr, bias))))
        ahead_s = time_s[j] - time_s[k]
        if ahead_s < AHEAD_S - 1e-6 or ahead_s > LONGEST_S:
            continue
        q = normalize(q)
        _, _, acc, mag, has_mag = reading_of(rows, j)
        down[j, 0], down[j, 1], down[j, 2] = rotate(q, unit(scale(-1.0, acc)))
        if has_mag:
            field[j, 0], field[j, 1], field[j, 2] = rotate(q, unit(mag))
    return down, field


def heading_errors(field: Floats) -> Floats:
    """Angle (N,) of the field's horizontal part from its mean direction, rad.

    Where north is does not matter: only that it stays.
    """
    angles = np.arctan2(field[:, 1], field[:, 0])
    seen = angles[np.isfinite(angles)]
    mean = atan2(float(np.sin(seen).sum()), float(np.cos(seen).sum())) if len(seen) else 0.0
    return np.abs(wrap(angles - mean))
