"""The magnetometer's readings without what the estimator has learnt about the magnetometer."""

import numpy as np

from estimator.conditioning.field.calibration import own_field
from estimator.conditioning.field.magnetic import MOST_DISTORTION
from estimator.conditioning.params import CONFIRM_S
from estimator.geometry.rotations import cross, rotate, wrap
from estimator.live.rows import blocks
from estimator.smoothing.path import late_s
from estimator.smoothing.recording import Recording, estimates_of
from estimator.smoothing.windows import running_mean
from estimator.types import Bools, Floats


def corrected_fields(recording: Recording) -> tuple[Floats, float]:
    """Fields (N, 3) less the vehicle's own, at the samples' times, and what is left of that.

    It is the variance of an axis, as a share of the place's field. See
    :func:`estimator.conditioning.field.calibration.correct_field`.
    """
    learnt = recording.last.core.conditioning.field.calibration.learnt
    own, left = own_field(learnt)
    lag_s = late_s(recording) + learnt.lag_s
    mag = recording.rows.mag_gauss - learnt.scale * np.array(own)
    return without_lag(mag, recording.rate_rad_s, lag_s), left


def without_lag(m: Floats, rate_rad_s: Floats, lag_s: Floats | float) -> Floats:
    """Fields (N, 3) as they were that much later: exp(-[w]x lag) m to second order."""
    first = cross(rate_rad_s, m)
    second = cross(rate_rad_s, first)
    return np.asarray(m - lag_s * first + 0.5 * lag_s**2 * second)


def usable_fields(recording: Recording) -> Bools:
    """Which fields (N,) count on the way back while velocity helps.

    While a field points elsewhere for long, either it or the heading may be wrong. If it points as
    usual before and behind, it was the field.
    """
    rows, aided = recording.rows, recording.last.core.aided
    counts, forward = rows.has_mag.copy(), estimates_of(recording.output)
    at = np.flatnonzero(counts & forward.is_aided)
    if len(at) < 2:
        return counts
    off = np.zeros(len(at))
    for part in blocks(len(at)):
        mag = rows.mag_gauss[at[part]] - np.array(aided.estimate.hard_iron_gauss)
        seen = rotate(forward.q_ned_frd[at[part]], mag)
        off[part] = np.arctan2(seen[:, 1], seen[:, 0])
    off -= np.median(off)
    median_s = 1e-6 * float(np.median(np.diff(rows.times_us[at])))
    count = max(1, round(2.0 * CONFIRM_S / median_s))
    counts[at] = np.abs(running_mean(wrap(off), count)) <= MOST_DISTORTION
    return counts
