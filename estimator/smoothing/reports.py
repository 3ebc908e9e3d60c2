"""Velocities and others' rates, as an estimator was told them on its way through a recording."""

from array import array
from collections.abc import Callable, Iterator
from heapq import merge
from operator import attrgetter

import numpy as np

from estimator.types import RateSample, VelocitySample


class Reports:
    """In the order in which they came; rates are packed, since an hour at 400 Hz has millions."""

    def __init__(self) -> None:
        self._velocities: list[VelocitySample] = []
        self._times_us, self._rates_rad_s = array("q"), array("d")

    def __bool__(self) -> bool:
        return bool(self._velocities or self._times_us)

    def add(self, report: VelocitySample | RateSample) -> None:
        """One more."""
        if isinstance(report, VelocitySample):
            self._velocities.append(report)
        else:
            self._times_us.append(report.time_us)
            self._rates_rad_s.extend(report.rate_rad_s)

    def turned_round(
        self, mirrored_us: int, age_s: Callable[[VelocitySample], float], late_s: float
    ) -> Iterator[VelocitySample | RateSample]:
        """Them in time turned round, in that order: times are those to ``mirrored_us``.

        A velocity is brought to its own time by its age, and is late by no more than ``late_s``.
        """

        def turned(report: VelocitySample) -> VelocitySample:
            x, y, z = report.velocity_ned_m_s
            return report._replace(
                time_us=mirrored_us - report.time_us + round(1e6 * age_s(report)),
                velocity_ned_m_s=(-x, -y, -z),
                late_sigma_s=min(report.late_sigma_s, late_s),
            )

        velocities = sorted(map(turned, self._velocities), key=attrgetter("time_us"))
        return merge(self._rates_turned_round(mirrored_us), velocities, key=attrgetter("time_us"))

    def _rates_turned_round(self, mirrored_us: int) -> Iterator[RateSample]:
        times_us = mirrored_us - np.frombuffer(self._times_us, np.int64)
        rates = np.frombuffer(self._rates_rad_s).reshape(-1, 3)
        for row in np.argsort(times_us, kind="stable"):
            x, y, z = rates[row].tolist()
            yield RateSample(int(times_us[row]), (-x, -y, -z))
