"""What an estimator says when it is told again what one was told in flight."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.core import with_attitude
from estimator.live.rows import BIAS, SAID, SIGMA, Q, Rows, blocks, cut
from estimator.row_taking import take, take_row
from estimator.types import Quaternion
from tuning.logged_calls import Call

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
    rows: Rows,
    calls: Mapping[int, Sequence[Call]],
    wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG,
) -> Course:
    """Have the estimator take all rows, before each of them what it was told then.

    Behind each sample in ``wrong_ned_frd`` the filter is given that attitude; what conditions its
    vectors goes on.
    """
    n, begin = len(rows.times_us), 0
    course = Course(np.empty((n, 4)), np.empty((n, 2)), np.empty((n, 3)))
    wrong = {at for k in wrong_ned_frd for at in (k, k + 1)}
    stops = {*calls, *wrong, *(part.stop for part in blocks(n))}
    for end in sorted(k for k in stops if 0 < k <= n):
        for call in calls.get(begin, ()):
            call(estimator)
        if end == begin + 1:
            time_us = take_row(estimator, rows, begin)
            if begin in wrong_ned_frd:
                now = estimator.snapshot
                core = with_attitude(now.core, wrong_ned_frd[begin])
                estimator.snapshot = now._replace(core=core)
            one = estimator.attitude(time_us)
            sigma = one.sigma_inclination_rad, one.sigma_heading_rad
            course.q_ned_frd[begin], course.sigma_rad[begin] = one.q_ned_frd, sigma
            course.bias_rad_s[begin] = one.gyro_bias_rad_s
        else:
            said = np.empty((end - begin, SAID))
            take(estimator, cut(rows, begin, end), said, np.empty(len(said), np.bool_))
            for column, part in zip(course, (Q, SIGMA, BIAS), strict=True):
                column[begin:end] = said[:, part]
        begin = end
    return course
