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
from tuning.online.segment import Segment, fly_segments, rows_of_all
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


def cost_on(profile: Profile, *segments: Segment) -> Cost:
    """The cost on the last of the segments, flown from the first on."""
    readings = readings_of(rows_of_all(segments))
    flown = fly_segments(profile, segments)
    first = sum(len(segment.samples) for segment in segments[:-1])
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
    """Mean of sin^2 of half the angle between foretold and measured vectors, by half seconds.

    The field's is the angle to its known direction; where the profile learns that, the angle of
    its horizontal part to its mean.
    """
    down, field = predicted_vectors(readings, q, bias, first)
    off = 0.5 * (1.0 - down @ DOWN)
    seen = np.isfinite(field[:, 0])
    if seen.any():
        known = profile.reference.magnetic
        if known == "learn":
            field = _units(field * (1.0, 1.0, 0.0))
            north = _units(field[seen].mean(axis=0))
        else:
            north = np.array(unit(known))
        off_north = 0.5 * (1.0 - field @ north)
        off = np.where(np.isfinite(off_north), 0.5 * (off + off_north), off)
    known_off = np.isfinite(off)
    block = (readings.time_s[known_off] / BLOCK_S).astype(int)
    found = [float(off[known_off][block == b].mean()) for b in np.unique(block)]
    return np.array(found or [0.0])


def _units(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-9))


def _pull_in(profile: Profile, segment: Segment) -> float:
    """Mean e between an estimate that begins 170 deg off and one that does not, over a second."""
    end_us = segment.samples[0].time_us + 1e6 * PULL_IN_S
    count = max(1, sum(sample.time_us <= end_us for sample in segment.samples))
    right = fly_segments(profile, (segment,), most=count)
    wrong = fly_segments(profile, (segment,), WRONG_TURN, most=count)
    angles = batch_angle_errors(wrong.q_ned_frd, right.q_ned_frd)[:, 0]
    return float(np.mean(np.sin(0.5 * angles) ** 2))
