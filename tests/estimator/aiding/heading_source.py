"""A source of aiding that the product does not have: a heading, as two GNSS antennas give it."""

from math import atan2, cos, sin
from typing import NamedTuple

import numpy as np

from estimator.aiding.covariance import learn
from estimator.aiding.sources.source import Source, refusal_of_numbers
from estimator.aiding.types import SIZE, TURN
from estimator.compilation.compiled import inlined


class HeadingSample(NamedTuple):
    """From true north, clockwise, with its sigma."""

    time_us: int
    heading_rad: float
    sigma_rad: float


@inlined
def observe_heading(params, now, report, ago_s, x):
    """A turn about down turns the heading by as much, and the rate has turned it since."""
    w, i, j, k = now.estimate.q_ned_frd
    heading = atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
    heading -= ago_s * now.rate_rad_s[2]
    off = report.heading_rad - heading
    off = atan2(sin(off), cos(off))
    h = np.zeros(SIZE)
    h[TURN + 2] = 1.0
    learn(now.covariance, x, h, off, report.sigma_rad**2)


HEADING_SOURCE = Source(HeadingSample(0, 0.0, 0.0), observe_heading, refusal_of_numbers)
