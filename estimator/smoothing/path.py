"""The attitude by the gyroscope only, in a frame that stands still except for its errors."""

from typing import NamedTuple

import numpy as np

from estimator.conditioning.rate import LEAST_PEAK_RAD_S, MOST_ERROR, SLOW_SAMPLE_S
from estimator.geometry.rotations import chained, cross, exp
from estimator.smoothing.recording import Recording, steps_s
from estimator.types import Bools, Floats


class Path(NamedTuple):
    """The body in frame G, which begins as the body's axes."""

    time_s: Floats  # (N,)
    q_g_frd: Floats  # (N, 4)
    rate_rad_s: Floats  # (N, 3) less the bias, FRD
    aliasing: Floats  # (N,) variance of the turn missed since the sample before, rad^2


def path_of(recording: Recording) -> Path:
    """The gyroscope's rates as turns from sample to sample.

    See :mod:`estimator.conditioning.rate`.
    """
    rate, dt_s = recording.rate_rad_s, steps_s(recording.rows)[:, None]
    before = np.concatenate([rate[:1], rate[:-1]])
    mean = np.where(stands_for_step(recording)[:, None], rate, 0.5 * (before + rate))
    mean += dt_s / 12.0 * cross(before, rate)
    time_s = 1e-6 * recording.rows.times_us.astype(np.float64)
    return Path(time_s, chained(exp(mean * dt_s)), rate, aliased_turn(recording))


def stands_for_step(recording: Recording) -> Bools:
    """Whether a sample (N,) counts as the mean over the step before it."""
    averaged = recording.last.settings.conditioning.averaged_samples
    return np.asarray(averaged | (steps_s(recording.rows) < SLOW_SAMPLE_S))


def aliased_turn(recording: Recording) -> Floats:
    """Variance (N,) of the turn missed at a gyroscope's end since the sample before, rad^2.

    See :mod:`estimator.conditioning.rate`.
    """
    gyr, dt_s = recording.rows.gyr_rad_s, steps_s(recording.rows)
    at, variance = np.arange(len(gyr)), np.zeros(len(gyr))
    clipping = recording.last.core.gathered.clipping
    for rate, peak in zip(gyr.T, clipping.peak_rad_s, strict=True):
        is_at_end = (np.abs(rate) >= max(peak, LEAST_PEAK_RAD_S)) & (np.diff(rate, prepend=0) == 0)
        begun = np.maximum.accumulate(np.where(is_at_end, 0, at))
        time_s = np.cumsum(dt_s)
        run_s = time_s - time_s[begun]
        added = np.where(is_at_end, run_s**2 - (run_s - dt_s) ** 2, 0.0)
        variance += (MOST_ERROR * peak) ** 2 * added
    return variance


def late_s(recording: Recording) -> Floats:
    """How old (N, 1) the mean over a step is at its end."""
    half_s = 0.5 * steps_s(recording.rows)
    return np.where(stands_for_step(recording), half_s, 0.0)[:, None]
