"""Recordings as another IMU, rate or start would have made them: named changes, from a seed."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from common.recordings import Array, Trial

Rng = np.random.Generator
STARTS, START_S, SETTLE_S, LEAST_SCORED_S = 10, 30.0, 10.0, 3.0


def means(trial: Trial, _: Rng, rate_hz: float) -> Trial:
    """Block means, which the filter knows; truth and score are those of the block's end."""
    block = max(1, round(trial.rate_hz / rate_hz))
    if block == 1:
        return trial
    ends = trial.cut(slice(block - 1, None, block))
    n = len(ends.moving)
    columns = (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
    gyr, acc, mag = (x[: n * block].reshape(n, block, 3).mean(axis=1) for x in columns)
    return replace(ends, gyr_rad_s=gyr, acc_m_s2=acc, mag_ut=mag, averaged=True)


def starts(trial: Trial, _: Rng, shift: float) -> list[Trial]:
    """Half a minute from each of ten times in motion on, scored from 10 s after; at rest nothing.

    ``shift`` moves them by that share of the time between two.
    """
    moving = np.flatnonzero(trial.moving)
    span = round(START_S * trial.rate_hz)
    first, last = moving[0], max(moving[0] + 1, moving[-1] - span)
    found = []
    for k in range(STARTS):
        at = min(last, first + round((k + shift) * (last - first) / (STARTS - 1)))
        begin = int(moving[np.searchsorted(moving, at)])
        short = trial.cut(slice(begin, begin + span))
        counted = short.scored & (short.times_s >= SETTLE_S)
        if counted.sum() >= LEAST_SCORED_S * trial.rate_hz:
            found.append(replace(short, scored=counted))
    return found


def accelerometer_bias(trial: Trial, rng: Rng) -> Trial:
    """0.15 m/s^2 an axis."""
    return replace(trial, acc_m_s2=trial.acc_m_s2 + rng.normal(0.0, 0.15, 3))


def scales_and_axes(trial: Trial, rng: Rng) -> Trial:
    """Scales and axes off by 0.5 % (gyroscope), 1 % (accelerometer), 2 % (magnetometer)."""
    gyr, acc, mag = (
        np.ascontiguousarray(x @ (np.eye(3) + rng.normal(0.0, share, (3, 3))).T)
        for x, share in ((trial.gyr_rad_s, 0.005), (trial.acc_m_s2, 0.01), (trial.mag_ut, 0.02))
    )
    return replace(trial, gyr_rad_s=gyr, acc_m_s2=acc, mag_ut=mag)


def gyroscope_bias(trial: Trial, rng: Rng) -> Trial:
    """0.4 deg/s an axis, and a step of 0.3 deg/s at 30 to 60 % of the time."""
    gyr = trial.gyr_rad_s + np.radians(rng.normal(0.0, 0.4, 3))
    gyr[int(len(gyr) * rng.uniform(0.3, 0.6)) :] += np.radians(rng.normal(0.0, 0.3, 3))
    return replace(trial, gyr_rad_s=gyr)


def passing_magnets(trial: Trial, rng: Rng) -> Trial:
    """Two bumps of 0.2 to 0.8 times the field, 0.7 to 2.5 s wide (sigma), in the body."""
    mag, norm, times = trial.mag_ut.copy(), trial.field_ut, trial.times_s
    for _ in range(2):
        middle = rng.uniform(10.0, times[-1] - 10.0)
        size = direction(rng) * rng.uniform(0.2, 0.8) * norm
        mag += np.exp(-0.5 * ((times - middle) / rng.uniform(0.7, 2.5)) ** 2)[:, None] * size
    return replace(trial, mag_ut=mag)


def cut_gyroscope(trial: Trial, rng: Rng) -> Trial:
    """It ends at 45 to 75 % of the trial's largest reading."""
    most = float(np.abs(trial.gyr_rad_s).max() * rng.uniform(0.45, 0.75))
    return replace(trial, gyr_rad_s=np.clip(trial.gyr_rad_s, -most, most))


def iron(trial: Trial, rng: Rng, share: float, field_ut: float = 0.0) -> Trial:
    """A hard iron of that share of the field, or of another one, in any direction."""
    offset_ut = direction(rng) * share * (field_ut or trial.field_ut)
    return replace(trial, mag_ut=trial.mag_ut + offset_ut)


def direction(rng: Rng) -> Array:
    """A unit vector, none more likely than another."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


WAYS: dict[str, Callable[[Trial, Rng], Trial | list[Trial]]] = {
    "as recorded": lambda trial, _: trial,
    "from the first movement on": lambda trial, _: trial.cut(
        slice(int(np.argmax(trial.moving)), None)
    ),
    **{f"{hz} Hz, means": partial(means, rate_hz=hz) for hz in (100, 50, 25, 10)},
    "started in motion": partial(starts, shift=0.0),
    "started in motion, shifted": partial(starts, shift=0.5),
    "accelerometer's bias": accelerometer_bias,
    "scales and axes": scales_and_axes,
    "gyroscope's bias, and a step of it": gyroscope_bias,
    "magnets pass": passing_magnets,
    "gyroscope cut": cut_gyroscope,
    "5 % of iron": partial(iron, share=0.05),
    "20 % of iron": partial(iron, share=0.2),
}
