"""Trials as another IMU would have recorded them: named errors, each from a seed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from broad_data import Array, Trial, crop, cut, decimate

LOW_RATE_HZ = 25.0
Worse = Callable[[Trial, np.random.Generator], Trial]


def first_movement(trial: Trial, _rng: np.random.Generator) -> Trial:
    """No rest at the start."""
    return crop(trial)


def means(trial: Trial, _rng: np.random.Generator) -> Trial:
    """Block means at 25 Hz, and the filter is told so."""
    return decimate(trial, LOW_RATE_HZ)


def instants(trial: Trial, _rng: np.random.Generator) -> Trial:
    """One sample of each block, at 25 Hz."""
    block = max(1, round(trial.rate_hz / LOW_RATE_HZ))
    return cut(trial, slice(block - 1, None, block))


def noise(trial: Trial, rng: np.random.Generator) -> Trial:
    """White noise of a cheap sensor: 4e-4 rad/s, 6 mm/s^2 and 0.08 uT a root of Hz."""
    root = np.sqrt(trial.rate_hz)

    def noisy(x: Array, density: float) -> Array:
        return np.asarray(x + rng.normal(0.0, density * root, x.shape))

    return replace(
        trial,
        gyr_rad_s=noisy(trial.gyr_rad_s, 4e-4),
        acc_m_s2=noisy(trial.acc_m_s2, 0.006),
        mag_ut=noisy(trial.mag_ut, 0.08),
    )


def accelerometer_bias(trial: Trial, rng: np.random.Generator) -> Trial:
    """0.15 m/s^2 an axis."""
    return replace(trial, acc_m_s2=trial.acc_m_s2 + rng.normal(0.0, 0.15, 3))


def scales_and_axes(trial: Trial, rng: np.random.Generator) -> Trial:
    """Scales and axes off by 0.5 % (gyroscope), 1 % (accelerometer), 2 % (magnetometer)."""

    def bent(x: Array, share: float) -> Array:
        return np.ascontiguousarray(x @ (np.eye(3) + rng.normal(0.0, share, (3, 3))).T)

    return replace(
        trial,
        gyr_rad_s=bent(trial.gyr_rad_s, 0.005),
        acc_m_s2=bent(trial.acc_m_s2, 0.01),
        mag_ut=bent(trial.mag_ut, 0.02),
    )


def gyroscope_bias(trial: Trial, rng: np.random.Generator) -> Trial:
    """0.4 deg/s an axis, and a step of 0.3 deg/s at 30 to 60 % of the time."""
    gyr = trial.gyr_rad_s + np.radians(rng.normal(0.0, 0.4, 3))
    gyr[int(len(gyr) * rng.uniform(0.3, 0.6)) :] += np.radians(rng.normal(0.0, 0.3, 3))
    return replace(trial, gyr_rad_s=gyr)


def passing_magnets(trial: Trial, rng: np.random.Generator) -> Trial:
    """Two bumps of 0.2 to 0.8 times the field, 0.7 to 2.5 s wide (sigma), in the body."""
    mag, norm = trial.mag_ut.copy(), median_norm(trial)
    times = np.arange(len(mag)) * trial.dt_s
    for _ in range(2):
        middle = rng.uniform(10.0, times[-1] - 10.0)
        size = direction(rng) * rng.uniform(0.2, 0.8) * norm
        mag += np.exp(-0.5 * ((times - middle) / rng.uniform(0.7, 2.5)) ** 2)[:, None] * size
    return replace(trial, mag_ut=mag)


def cut_gyroscope(trial: Trial, rng: np.random.Generator) -> Trial:
    """It ends at 45 to 75 % of the trial's largest reading."""
    most = float(np.abs(trial.gyr_rad_s).max() * rng.uniform(0.45, 0.75))
    return replace(trial, gyr_rad_s=np.clip(trial.gyr_rad_s, -most, most))


def iron(share: float) -> Worse:
    """A hard iron of that share of the field, in any direction."""

    def added(trial: Trial, rng: np.random.Generator) -> Trial:
        return replace(trial, mag_ut=trial.mag_ut + direction(rng) * share * median_norm(trial))

    return added


def as_recorded(trial: Trial, _rng: np.random.Generator) -> Trial:
    return trial


def median_norm(trial: Trial) -> float:
    """Of the field, uT."""
    return float(np.median(np.linalg.norm(trial.mag_ut, axis=1)))


def direction(rng: np.random.Generator) -> Array:
    """A unit vector, none more likely than another."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


WORSE: dict[str, Worse] = {
    "as recorded": as_recorded,
    "from the first movement on": first_movement,
    "25 Hz, means": means,
    "25 Hz, instants": instants,
    "noise added": noise,
    "accelerometer's bias": accelerometer_bias,
    "scales and axes": scales_and_axes,
    "gyroscope's bias, and a step of it": gyroscope_bias,
    "magnets pass": passing_magnets,
    "gyroscope cut": cut_gyroscope,
    "5 % of iron": iron(0.05),
    "20 % of iron": iron(0.2),
}
