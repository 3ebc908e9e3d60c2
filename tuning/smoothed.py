"""The reference that a flight gives itself: its attitude by the whole recording.

It is made once, before the search, with the base profile: no number under search can draw it to
itself, and what is held out is judged by a reference that nothing was chosen on. Its own sigma is
how far it may be off; a cost is the mean over attitudes that lie so far around it.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtri

from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.geometry.rotations import exp, multiply
from estimator.profile import Profile
from estimator.smoothing import Recorder, smooth_all
from tuning.course import course_of
from tuning.flight import Flight

# A smoothed inclination, and a heading, count where their sigmas are below these, deg; a flight if
# half of them do. Autopilots' own attitudes are hardly better.
SURE_DEG = (2.0, 5.0)
# Attitudes around a reference that is uncertain.
AROUND = 8
# Of a normal error a share of 0.68 lies under so many standard deviations: of one component, and
# of two together.
ONE, TWO = 0.994, 1.510
# Turns between two azimuths, so that any few of them are spread out.
GOLDEN = 0.618034


def sure_flight(flight: Flight, profile: Profile, *, is_wanted: bool) -> Flight:
    """The flight with its smoothed attitude for a reference if that is sure of itself.

    Raises:
        InputError: it is not, and is wanted.
    """
    recorder = Recorder(profile)
    course_of(recorder, flight.rows, flight.calls, reports=flight.reports)
    times_us, smoothed = smooth_all(recorder)
    at = np.searchsorted(times_us, flight.rows.times_us)
    truth, sigma = smoothed.q_ned_frd[at], smoothed.sigma_rad[at]
    sure = np.isfinite(truth).all(axis=1, keepdims=True) & (np.degrees(sigma) < SURE_DEG)
    known, headed = sure[:, 0], flight.headed & sure[:, 1]
    half = len(truth) / 2
    has_north = flight.has_field and flight.headed.sum() > half
    shares = 50.0 * known.sum() / half, 50.0 * (known & headed).sum() / half
    if shares[0] > 50.0 and (not has_north or shares[1] > 50.0):
        return flight._replace(
            reference="smooth", truth=truth, known=known, headed=headed, truth_sigma_rad=sigma
        )
    if is_wanted:
        raise InputError(
            f"{flight.name}: --reference smooth: the whole log knows inclination and heading to "
            f"{SURE_DEG[0]:g} and {SURE_DEG[1]:g} deg in {shares[0]:.0f} and {shares[1]:.0f} % only"
        )
    return flight


def possible_truths(truth: Floats, sigma_rad: Floats | None) -> Iterator[Floats]:
    """References (N, 4), or if they have sigmas ``AROUND`` others as likely as each other."""
    if sigma_rad is None:
        yield truth
        return
    share = (np.arange(AROUND) + 0.5) / AROUND
    tilt = np.sqrt(-2.0 * np.log(share)) / TWO
    azimuth = 2.0 * np.pi * GOLDEN * np.arange(AROUND)
    # in another order than the tilts
    turn = ndtri(share[np.argsort(GOLDEN * np.arange(AROUND) % 1.0)]) / ONE
    level, north = sigma_rad.T
    for t, a, h in zip(tilt, azimuth, turn, strict=True):
        each = np.stack([level * t * np.cos(a), level * t * np.sin(a), north * h], axis=-1)
        yield multiply(exp(each), truth)
