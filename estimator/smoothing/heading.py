"""The heading by the field of the whole recording.

Between two windows the heading of the levelled path changes as the gyroscope errs, a random walk of
variance q, and by the scale errors s of its axes, of the prior variance v. Each window's field
shows it with a variance r, larger if norm or dip are off the place's. The smoothed heading is the
least squares solution, a tridiagonal system beside three errors of scale: sum (z - x)^2 / r + sum
(x' - x - a s)^2 / q + s^2 / v. Noises are those of the estimator's own heading.
"""

from math import atan2

import numpy as np
from scipy.linalg import solveh_banded

from estimator.bounds import TINY
from estimator.conditioning.field.magnetic import (
    DIP_SCALE_RAD,
    NORM_SCALE,
    FieldReference,
    norm_of,
    steepness,
)
from estimator.conditioning.params import HEADING_REACH_RAD, USUAL_S, ConditioningParams
from estimator.conditioning.vertical.averaging import WINDOW_S
from estimator.conditioning.vertical.slow_acceleration import SCALE_ERROR
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.geometry.rotations import about_down, multiply, rotate, rotate_inverse, wrap
from estimator.smoothing.field import corrected_fields
from estimator.smoothing.path import Path
from estimator.smoothing.recording import Recording
from estimator.smoothing.vertical import Vertical
from estimator.smoothing.windows import Windows, filled, running_mean
from estimator.types import DOWN, Bools, Floats

# Rounds of least squares with the weights of the one before.
ROUNDS = 8
# The scale error of a small gyroscope, as a share of its rate.
SCALE_SIGMA = 0.005
# Of the drift that the estimator allows for: the bias is what later samples show.
DRIFT_SHARE = 0.3
# Of how far the field points sideways for a short time, over the time of the heading's average.
SLOW_ERROR_SHARE = 0.05
# The variance of a window without a field, rad^2.
UNSEEN = 1e9


def turn_north(
    recording: Recording, windows: Windows, path: Path, vertical: Vertical
) -> tuple[Floats, Floats]:
    """The levelled path turned to north, (N, 4), and the heading's sigma (N,)."""
    settings = recording.last.settings
    params, north = settings.conditioning, settings.reference.magnetic_ned
    declination_rad = atan2(north[1], north[0])
    reference = recording.last.core.conditioning.field.magnetic.reference
    mag, own_variance = corrected_fields(recording)
    seen, samples = windows.means(rotate(vertical.q_6d_frd, mag), recording.rows.has_mag)
    known = samples > 0.0
    turning, _ = windows.means(np.sum(path.rate_rad_s**2, axis=1))
    r = np.where(known, noise(params, seen, reference) / WINDOW_S, UNSEEN)
    aliasing, count = windows.means(path.aliasing)
    q = walk(params, turning) + (aliasing * count)[1:]
    z = np.where(known, -np.arctan2(seen[:, 1], seen[:, 0]), 0.0)
    x, weight, by_scale = solve(z, r, q, turned(windows, path, vertical), HEADING_REACH_RAD)
    tilt_variance = 0.5 * steepness(reference) * vertical.variance
    variance = variances(r * weight, q) + by_scale
    variance += constant_error(seen, known, reference, tilt_variance)
    variance += (1.0 + steepness(reference)) * own_variance
    heading = windows.at(path.time_s, x) + declination_rad
    q_ned_frd = multiply(about_down(heading), vertical.q_6d_frd)
    return q_ned_frd, np.sqrt(windows.at(path.time_s, variance))


def noise(params: ConditioningParams, seen: Floats, reference: FieldReference) -> Floats:
    """Density (W,) of the error of the field's heading, rad^2 s: see conditioning/field/step."""
    off_norm, off_dip = deviations(seen, reference)
    square = (off_norm / NORM_SCALE) ** 2 + (off_dip / DIP_SCALE_RAD) ** 2
    confidence = np.maximum((1.0 + square) ** -2, TINY)
    uncertain = params.heading_inflation_noise_rad2_s * (1.0 / confidence - 1.0)
    return np.asarray(params.heading_noise_rad2_s + uncertain)


def deviations(seen: Floats, reference: FieldReference) -> tuple[Floats, Floats]:
    """See :func:`estimator.conditioning.field.magnetic.deviation`."""
    horizontal, down = np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]
    expected = norm_of((reference.horizontal, reference.down))
    norm = np.maximum(np.hypot(horizontal, down), TINY * expected)
    off_norm = (norm - expected) / expected
    off_dip = (down * reference.horizontal - horizontal * reference.down) / (norm * expected)
    return off_norm, off_dip


def walk(params: ConditioningParams, turning: Floats) -> Floats:
    """Variance (W - 1,) of the drift from window to window, of mean squared rates (W,)."""
    steady = params.heading_noise_rad2_s / USUAL_S**2
    both = 0.5 * (turning[1:] + turning[:-1])
    return np.asarray(DRIFT_SHARE * (steady + params.heading_turning_noise_s * both) * WINDOW_S)


def turned(windows: Windows, path: Path, vertical: Vertical) -> Floats:
    """The angle (rad, (W - 1, 3)) by which each axis of the gyroscope has turned the heading."""
    down = rotate_inverse(vertical.q_6d_frd, DOWN)
    means, _ = windows.means(down * path.rate_rad_s)
    return np.asarray(0.5 * WINDOW_S * (means[1:] + means[:-1]))


def solve(
    z: Floats, r: Floats, q: Floats, a: Floats, reach_rad: float
) -> tuple[Floats, Floats, Floats]:
    """The smoothed angles (W,), and two things about their variances (W,).

    By what robust weights have multiplied those of the field, and what not knowing the scale errors
    adds to those of the angles.
    """
    middle = np.angle(np.sum(np.exp(1j * z) / r))
    unwrapped = middle + wrap(z - middle)
    weight = np.ones_like(z)
    for _ in range(ROUNDS):
        x, by_scale = least_squares(unwrapped, r * weight, q, a)
        off = wrap(z - x)
        unwrapped = x + off
        weight = (1.0 + (off / reach_rad) ** 2) ** 2
    return x, weight, by_scale


def least_squares(z: Floats, r: Floats, q: Floats, a: Floats) -> tuple[Floats, Floats]:
    """The minimum over x and s, and what not knowing s adds to the variances (W,) of x."""
    bands = np.zeros((2, len(z)))
    bands[0, 1:] = -1.0 / q
    bands[1] = 1.0 / r
    bands[1, 1:] += 1.0 / q
    bands[1, :-1] += 1.0 / q
    along = a / q[:, None]
    push = np.zeros((len(z), a.shape[1]))
    push[1:] += along
    push[:-1] -= along
    solved = solveh_banded(bands, np.column_stack([z / r, push]))
    x, by_s = solved[:, 0], solved[:, 1:]
    known = a.T @ along - push.T @ by_s + np.eye(a.shape[1]) / SCALE_SIGMA**2
    covariance = np.linalg.inv(known)
    x = x + by_s @ (covariance @ (push.T @ x))
    return x, np.sum((by_s @ covariance) * by_s, axis=1)


def variances(r: Floats, q: Floats) -> Floats:
    """The variances (W,) where s is known: information from before, from behind and its own."""
    before = informed(r, q)
    behind = informed(r[::-1], q[::-1])[::-1]
    return np.asarray(1.0 / (before + behind + 1.0 / r))


def informed(r: Floats, q: Floats) -> Floats:
    """What all before it show of each, 1/rad^2."""
    information = np.zeros_like(r)
    for k, (own, drift) in enumerate(zip((1.0 / r[:-1]).tolist(), q.tolist(), strict=True)):
        both = own + float(information[k])
        information[k + 1] = both / (1.0 + both * drift)
    return information


def constant_error(
    seen: Floats, known: Bools, reference: FieldReference, tilt_variance: Floats
) -> Floats:
    """Variance (W,) of constant errors, by how far norm and dip are off, and by a tilted vertical.

    What turns the field up or stretches it also turns it sideways, see conditioning/sigma.
    """
    off = np.minimum(np.abs(deviations(seen, reference)), NORM_SCALE)
    square = filled(np.sum(off**2, axis=0)[:, None], known)[:, 0]
    uneven = np.maximum(0.0, running_mean(square, round(USUAL_S / WINDOW_S)) - SCALE_ERROR**2)
    sideways = (1.0 + steepness(reference)) * uneven
    return np.asarray(SLOW_ERROR_SHARE * (sideways + tilt_variance) + LEAST_DIRECTION_RAD**2)
