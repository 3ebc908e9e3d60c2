"""What an estimator says when it is told again what one was told in flight."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.core import with_attitude
from estimator.types import ImuSample, Quaternion
from tuning.told import Call

# A wrong start: 170 deg about NED (1,1,1)/sqrt 3, next to the unstable equilibrium, as the paper
# begins (e = 0.992).
WRONG_TURN = exp(scale(radians(170.0), (3**-0.5, 3**-0.5, 3**-0.5)))
NOTHING_WRONG: Mapping[int, Quaternion] = {}


class Course(NamedTuple):
    """What an estimator said at its N samples.

    ``q_ned_frd`` (N, 4); ``sigma_rad`` (N, 2) of inclination and heading; ``bias_rad_s`` (N, 3).
    """

    q_ned_frd: Floats
    sigma_rad: Floats
    bias_rad_s: Floats


def course_of(
    estimator: Estimator,
    samples: Sequence[ImuSample],
    calls: Sequence[tuple[Call, ...]],
    wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG,
) -> Course:
    """Tell the estimator each sample's calls and ask it for the attitude at that sample.

    Behind each sample in ``wrong_ned_frd`` the filter is given that attitude; what conditions its
    vectors goes on.
    """
    rows = np.empty((len(samples), 9))
    for k, (sample, told) in enumerate(zip(samples, calls, strict=True)):
        for call in told:
            call(estimator)
        if k in wrong_ned_frd:
            now = estimator.snapshot
            estimator.snapshot = now._replace(core=with_attitude(now.core, wrong_ned_frd[k]))
        said = estimator.attitude(sample.time_us)
        rows[k, :4] = said.q_ned_frd
        rows[k, 4], rows[k, 5] = said.sigma_inclination_rad, said.sigma_heading_rad
        rows[k, 6:] = said.gyro_bias_rad_s
    return Course(rows[:, :4], rows[:, 4:6], rows[:, 6:])
