"""A recorded flight as what an estimator was given, and the replay of it with any profile.

What the service does with a log before its estimator (which message, which clock, what is refused)
does not depend on the numbers that are tuned. So it is done once and written down as calls; a
candidate's whole estimator, aiding included, then takes the same calls.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats
from estimator.calibration import PLAIN, Calibration
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.live.rows import NO_REPORT_ROWS, Rows, cut
from estimator.profile import Profile
from estimator.types import Quaternion
from tuning.course import NOTHING_WRONG, Calls, Course, course_of
from tuning.task import sensor_axes

LEAST_RATE_HZ = 1.0
BETTER_LOG = "record a better log: fuzzbee run URL --request-rate 50 --record FILE"
LEAST_DURATION_S = 60.0
# A vehicle that never turns faster than this, for this long in all, does not show how a filter
# copes with motion. At rest, engines running, the rates of recorded vehicles stay below 0.02 rad/s.
MOTION_RAD_S = 0.05
LEAST_MOTION_S = 10.0
# A compass that sends less often than this is as good as none.
LEAST_FIELD_RATE_HZ = 0.2


class Flight(NamedTuple):
    """N samples of one vehicle, as its estimator was given them.

    ``reports`` (M, REPORT_SIZE) are velocities and rates, ``calls[k]`` what else came before sample
    k, if there was something. ``truth`` (N, 4) is the reference's ``q_ned_frd`` where ``known``;
    ``reference`` is "sim", "autopilot", "smooth" or "none". ``headed`` marks where the base profile
    gave a heading. ``truth_sigma_rad`` (N, 2) are the reference's own sigmas of inclination and
    heading, if it has any. ``calibration`` is what the rows are calibrated by, ``begin_s`` when in
    its log the flight begins.
    """

    path: Path
    sha256: str
    message: str
    reference: str
    rows: Rows
    calls: Calls
    truth: Floats
    known: Bools
    headed: Bools
    reports: Floats = NO_REPORT_ROWS
    truth_sigma_rad: Floats | None = None
    calibration: Calibration = PLAIN
    begin_s: float = 0.0

    @property
    def name(self) -> str:
        """The log's, which does not depend on where it lies."""
        return self.path.name

    @property
    def restart(self) -> Bools:
        """Samples (N,) after which nothing from before holds: the first, a reboot, a new clock."""
        found = np.zeros(len(self.truth), dtype=bool)
        again = (k for k, calls in self.calls.items() if any(c.method == "restart" for c in calls))
        found[[0, *(k for k in again if k < len(found))]] = True
        return found

    @property
    def time_s(self) -> Floats:
        """Time (N,) since the first sample, on the vehicle's continuous clock."""
        times_us = self.rows.times_us
        time_s: Floats = 1e-6 * (times_us - times_us[0])
        return time_s

    @property
    def rate_hz(self) -> float:
        """Median rate of the samples."""
        steps_s = np.diff(self.time_s)[~self.restart[1:]]
        return float(1.0 / np.median(steps_s)) if len(steps_s) else 0.0

    @property
    def has_field(self) -> bool:
        """Whether there is a magnetic field often enough to be of use."""
        return bool(self.rows.has_mag.sum() > LEAST_FIELD_RATE_HZ * self.time_s[-1])


class Part(NamedTuple):
    """Samples first..last-1 of a flight: what is scored; the estimator runs from the beginning."""

    flight: Flight
    first: int
    last: int

    @property
    def window(self) -> slice:
        """The samples that are scored."""
        return slice(self.first, self.last)


def fly(
    flight: Flight,
    profile: Profile,
    last: int,
    wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG,
) -> Course:
    """The first ``last`` samples with the whole estimator of ``profile``; see :func:`course_of`."""
    rows = cut(flight.rows, 0, last)
    if profile.calibration != flight.calibration:
        rows = _calibrated(rows, profile)
    return course_of(Estimator(profile), rows, flight.calls, wrong_ned_frd, flight.reports)


def _calibrated(rows: Rows, profile: Profile) -> Rows:
    """Readings in the body's axes, by the calibration of their sensors."""
    R, sign = sensor_axes(profile.mounting), profile.mounting.acc_sign
    as_read = rows.gyr_rad_s @ R, sign * rows.acc_m_s2 @ R, rows.mag_gauss @ R
    gyr, acc, mag = map(np.ascontiguousarray, profile.to_body_rows(*as_read))
    return rows._replace(gyr_rad_s=gyr, acc_m_s2=acc, mag_gauss=mag)


def motion_s(flight: Flight) -> float:
    """For how long the vehicle turned. The median rate, and with it a bias, is taken off first."""
    gyr = flight.rows.gyr_rad_s
    rate = np.linalg.norm(gyr - np.median(gyr, axis=0), axis=1)
    return float(np.mean(rate > MOTION_RAD_S)) * float(flight.time_s[-1])


def require_substance(flight: Flight) -> None:
    """Refuse a flight that cannot show which numbers are better.

    Raises:
        InputError: it is too slow, too short or without motion.
    """
    name, rate_hz, duration_s = flight.name, flight.rate_hz, float(flight.time_s[-1])
    if rate_hz < LEAST_RATE_HZ:
        raise InputError(
            f"{name}: {flight.message} at {rate_hz:.2f} Hz; nothing can be tuned below "
            f"{LEAST_RATE_HZ:g} Hz ({BETTER_LOG})"
        )
    if duration_s < LEAST_DURATION_S:
        raise InputError(
            f"{name}: {duration_s:.0f} s of IMU data; at least {LEAST_DURATION_S:g} s are needed"
        )
    moving_s = motion_s(flight)
    if moving_s < LEAST_MOTION_S:
        raise InputError(
            f"{name}: no motion: it turns faster than {MOTION_RAD_S:g} rad/s for {moving_s:.0f} s, "
            f"at least {LEAST_MOTION_S:g} s are needed"
        )
