"""The cost of a profile on some seconds of flight, without truth.

Prediction: sin^2 of half the angle between the vectors that the estimate foretells half a second
ahead by the gyroscope alone, and those measured then, less the readings' own noise. Pull-in: the
mean of e over the second behind a wrong start, as if there were one each five minutes.
"""

from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import unit
from estimator.profile import Profile
from tuning.course import WRONG_TURN
from tuning.online.noise import Noise, noise_of
from tuning.online.segment import Segment, Window, fly_segments, rows_of_all
from tuning.prediction import AHEAD_S, Readings, predicted_vectors, readings_of

PULL_IN_S = 1.0
PULL_IN_WEIGHT = 1.0 / 300.0
# Errors of half a second have something in common; those of different ones are nearly independent.
BLOCK_S = 0.5
DOWN = np.array([0.0, 0.0, 1.0])


class Cost(NamedTuple):
    """``blocks`` (B,): of the prediction, half a second each, the readings' noise still in it."""

    blocks: Floats
    noise: float
    pull_in: float

    @property
    def total(self) -> float:
        """What is compared: about e, the paper's, on the average."""
        return max(float(np.mean(self.blocks)) - self.noise, 0.0) + PULL_IN_WEIGHT * self.pull_in


def cost_on(profile: Profile, window: Window, *, judged: bool) -> Cost:
    """The cost on the earlier segment; if ``judged``, on the later, flown from the earlier on."""
    segments = (window.earlier, window.later) if judged else (window.earlier,)
    readings = readings_of(rows_of_all(segments))
    flown = fly_segments(profile, segments)
    first = len(window.earlier.samples) if judged else 0
    blocks = _blocks(profile, readings, flown.q_ned_frd, flown.bias_rad_s, first)
    noise = noise_of(readings, first)
    floor = 0.0 if noise is None else _floor(noise, readings)
    return Cost(blocks, floor, _pull_in(profile, segments[-1]))


def _floor(noise: Noise, readings: Readings) -> float:
    """What of a prediction is the readings' noise: of the vector, and of the turn up to it.

    A vector is turned about two axes, each with a third of the gyroscope's mean square.
    """
    vector = noise.gravity
    if readings.has_mag.any():
        vector = 0.5 * (noise.gravity + noise.magnetic)
    turn = noise.gyroscope * 2.0 / 3.0 * float(np.median(np.diff(readings.time_s))) * AHEAD_S
    return 0.25 * (vector + turn)


def _blocks(profile: Profile, readings: Readings, q: Floats, bias: Floats, first: int) -> Floats:
    """Mean of sin^2 of half the angle between foretold and measured vectors, by half seconds."""
    down, field = predicted_vectors(readings, q, bias, first)
    off = 0.5 * (1.0 - down @ DOWN)
    north = _north(profile, field)
    if north is not None:
        off_north = 0.5 * (1.0 - _comparable(profile, field) @ north)
        off = np.where(np.isfinite(off_north), 0.5 * (off + off_north), off)
    known = np.isfinite(off)
    block = (readings.time_s[known] / BLOCK_S).astype(int)
    found = [float(off[known][block == b].mean()) for b in np.unique(block)]
    return np.array(found or [0.0])


def _comparable(profile: Profile, field: Floats) -> Floats:
    """Fields (N, 3) as they are compared: where the direction is learnt, the horizontal part."""
    if profile.reference.magnetic != "learn":
        return field
    level = field * np.array([1.0, 1.0, 0.0])
    horizontal: Floats = level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
    return horizontal


def _north(profile: Profile, field: Floats) -> Floats | None:
    """The field's known direction (3,), or its mean where the profile learns it; None without."""
    seen = np.isfinite(field[:, 0])
    if not seen.any():
        return None
    if profile.reference.magnetic != "learn":
        return np.array(unit(profile.reference.magnetic))
    mean = _comparable(profile, field[seen]).mean(axis=0)
    north: Floats = mean / max(float(np.linalg.norm(mean)), 1e-9)
    return north


def _pull_in(profile: Profile, segment: Segment) -> float:
    """Mean e between an estimate that begins 170 deg off and one that does not, over a second."""
    end_us = segment.samples[0].time_us + 1e6 * PULL_IN_S
    count = max(1, sum(sample.time_us <= end_us for sample in segment.samples))
    right = fly_segments(profile, (segment,), most=count)
    wrong = fly_segments(profile, (segment,), WRONG_TURN, most=count)
    angles = batch_angle_errors(wrong.q_ned_frd, right.q_ned_frd)[:, 0]
    return float(np.mean(np.sin(0.5 * angles) ** 2))
