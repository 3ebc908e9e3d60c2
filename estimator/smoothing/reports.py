"""What others told an estimator on its way through a recording, in time turned round."""

import numpy as np

from estimator.arrays import Floats, Times
from estimator.live.rows import IS_RATE, LATE_S, ROW, TIME, X, Z


def turned_round(
    told: Floats, times_us: Times, mirrored_us: int, velocity_age_s: Floats, late_s: float
) -> Floats:
    """Velocities and rates (M, TOLD) before the samples of ``times_us``, both turned round.

    Times are those to ``mirrored_us``. A velocity is brought to its own time by its age (M,), and
    is late by no more than ``late_s``.
    """
    is_rate, turned = told[:, IS_RATE] > 0.0, told.copy()
    age_us = np.where(is_rate, 0.0, np.rint(1e6 * velocity_age_s))
    turned[:, TIME] = mirrored_us - told[:, TIME] + age_us
    turned[:, X : Z + 1] = -told[:, X : Z + 1]
    turned[:, LATE_S] = np.minimum(told[:, LATE_S], late_s)
    turned[:, ROW] = np.searchsorted(times_us, turned[:, TIME])
    return np.asarray(turned[np.lexsort((~is_rate, turned[:, TIME]))])
