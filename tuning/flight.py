"""A recorded flight as what an estimator was given, and the replay of it with any profile.

What the service does with a log before its estimator (which message, which clock, what is refused)
does not depend on the numbers that are tuned. So it is done once and written down as calls; a
candidate's whole estimator, aiding included, then takes the same calls.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator.calibration import PLAIN, Calibration
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.live.rows import NO_REPORT_ROWS, SIGMA, Q, Rows, cut
from estimator.profile import Profile
from estimator.smoothing import Recorder, smooth_all
from estimator.types import Bools, Floats, Quaternion
from tuning.calls import NOTHING_WRONG, Calls, Course, course_of
from tuning.space import sensor_axes

BETTER_LOG = "record a better log: fuzzbee run URL --request-rate 50 --record FILE"
LEAST_RATE_HZ, LEAST_DURATION_S = 1.0, 60.0
# A vehicle that never turns faster than this, for this long in all, does not show how a filter
# copes with motion. At rest, engines running, the rates of recorded vehicles stay below 0.02 rad/s.
MOTION_RAD_S, LEAST_MOTION_S = 0.05, 10.0
LEAST_FIELD_RATE_HZ = 0.2  # a compass that sends less often is as good as none
# A smoothed inclination, and a heading, count where their sigmas are below these, deg; a flight if
# half of them do. Autopilots' own attitudes are hardly better.
SURE_DEG = (2.0, 5.0)


class Flight(NamedTuple):
    """N samples of one vehicle, as its estimator was given them.

    ``truth`` (N, 4) is the reference's ``q_ned_frd`` where ``known``; ``reference`` is "sim",
    "autopilot", "smooth" or "none". ``headed`` marks where the base profile gave a heading.
    ``calls[k]`` came before sample k, behind them ``reports`` (M, REPORT_SIZE), velocities and
    rates. ``truth_sigma_rad`` (N, 2) are the reference's own sigmas of inclination and heading, if
    any. ``calibration`` has been applied to the rows. ``refused`` is a line if much of the log was.
    Samples ``first`` to ``last`` - 1 are scored.
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
    begin_s: float = 0.0  # in its log
    refused: str | None = None
    first: int = 0
    last: int | None = None

    @property
    def window(self) -> slice:
        """The samples that are scored; the estimator runs from the beginning."""
        return slice(self.first, len(self.truth) if self.last is None else self.last)

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
        return np.asarray(1e-6 * (times_us - times_us[0]))

    @property
    def rate_hz(self) -> float:
        """Median rate of the samples."""
        steps_s = np.diff(self.time_s)[~self.restart[1:]]
        return float(1.0 / np.median(steps_s)) if len(steps_s) else 0.0

    @property
    def has_field(self) -> bool:
        """Whether there is a magnetic field often enough to be of use."""
        return bool(self.rows.has_mag.sum() > LEAST_FIELD_RATE_HZ * self.time_s[-1])


def fly(
    flight: Flight, profile: Profile, wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG
) -> Course:
    """The samples up to ``last`` by the whole estimator of ``profile``; see :func:`course_of`."""
    rows = cut(flight.rows, 0, flight.last)
    if profile.calibration != flight.calibration:  # the readings in the body's axes
        R, sign = sensor_axes(profile.mounting), profile.mounting.acc_sign
        as_read = rows.gyr_rad_s @ R, sign * rows.acc_m_s2 @ R, rows.mag_gauss @ R
        gyr, acc, mag = map(np.ascontiguousarray, profile.to_body_rows(*as_read))
        rows = Rows(rows.times_us, gyr, acc, mag, rows.has_mag)
    return course_of(Estimator(profile), rows, flight.calls, flight.reports, wrong_ned_frd)


def sure_flight(flight: Flight, profile: Profile, *, is_wanted: bool) -> Flight:
    """The flight with its attitude by the whole recording as reference if that is sure of itself.

    It is made with the base profile: no number under search can draw it to itself.

    Raises:
        InputError: it is not, and is wanted.
    """
    recorder = Recorder(profile)
    course_of(recorder, flight.rows, flight.calls, flight.reports)
    times_us, smoothed = smooth_all(recorder)
    at = np.searchsorted(times_us, flight.rows.times_us)
    truth, sigma = smoothed[at, Q], smoothed[at, SIGMA]
    sure = np.isfinite(truth).all(axis=1, keepdims=True) & (np.degrees(sigma) < SURE_DEG)
    known, headed = sure[:, 0], flight.headed & sure[:, 1]
    has_north = flight.has_field and flight.headed.mean() > 0.5
    shares = known.mean(), (known & headed).mean()
    if shares[0] > 0.5 and (not has_north or shares[1] > 0.5):
        return flight._replace(
            reference="smooth", truth=truth, known=known, headed=headed, truth_sigma_rad=sigma
        )
    if is_wanted:
        raise InputError(
            f"{flight.name}: --reference smooth: the whole log knows inclination and heading to "
            f"{SURE_DEG[0]:g} and {SURE_DEG[1]:g} deg in {100.0 * shares[0]:.0f} and "
            f"{100.0 * shares[1]:.0f} % only"
        )
    return flight


def require_substance(flight: Flight) -> None:
    """Refuse a flight that cannot show which numbers are better.

    Raises:
        InputError: it is too slow, too short or without motion.
    """
    rate_hz, duration_s = flight.rate_hz, float(flight.time_s[-1])
    # without the median rate, and with it without a bias
    turned = flight.rows.gyr_rad_s - np.median(flight.rows.gyr_rad_s, axis=0)
    moving_s = float(np.mean(np.linalg.norm(turned, axis=1) > MOTION_RAD_S)) * duration_s
    if rate_hz < LEAST_RATE_HZ:
        why = f"{flight.message} at {rate_hz:.2f} Hz; nothing can be tuned below "
        why += f"{LEAST_RATE_HZ:g} Hz ({BETTER_LOG})"
    elif duration_s < LEAST_DURATION_S:
        why = f"{duration_s:.0f} s of IMU data; at least {LEAST_DURATION_S:g} s are needed"
    elif moving_s < LEAST_MOTION_S:
        why = f"no motion: it turns faster than {MOTION_RAD_S:g} rad/s for {moving_s:.0f} s, "
        why += f"at least {LEAST_MOTION_S:g} s are needed"
    else:
        return
    raise InputError(f"{flight.name}: {why}")
