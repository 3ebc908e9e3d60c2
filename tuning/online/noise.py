"""What the readings themselves tell about their noise, without any estimate."""

from math import log
from typing import NamedTuple

import numpy as np

from estimator.compilation.compiled import compiled
from estimator.compilation.direct import types_of
from estimator.geometry.quaternion import dot, exp, norm, rotate_inverse, subtract, unit
from tuning.prediction import Readings, example_readings

# Two readings further apart tell about motion, not about noise.
LONGEST_STEP_S = 0.15
# Less noise than this counts as none: (1 mrad)^2, and (1 mrad/s)^2.
LEAST = 1e-6
# A mean square that has changed by less is what it was; noise twice as large changes it by four.
CHANGED = 2.0
# A field off by this share in strength, or its angle to gravity by so much, is another field.
FIELD_CHANGED = 0.2
ANGLE_CHANGED_RAD = 0.25


class Noise(NamedTuple):
    """Mean squares over a segment, and what the field is like.

    ``gravity`` and ``magnetic``: of the unit vector's noise, all three axes, from how far each
    reading is from the one before, turned on by the gyroscope. ``gyroscope``: of the rate's,
    (rad/s)^2, from reading to reading. ``strength`` is the field's, ``angle_rad`` that between
    field and gravity.
    """

    gravity: float
    magnetic: float
    gyroscope: float
    strength: float
    angle_rad: float


@compiled(types=lambda: types_of(example_readings(), 0))
def _sums(readings: Readings, first: int) -> tuple[float, float, float, float, float, int, int]:
    time_s, gyr, acc, mag, has_mag = readings
    gravity = magnetic = gyroscope = strength = cosine = 0.0
    steps = fields = 0
    last = -1  # with a field
    for k in range(first + 1, len(time_s)):
        dt = time_s[k] - time_s[k - 1]
        if dt > LONGEST_STEP_S:
            last = -1
            continue
        w = (gyr[k, 0], gyr[k, 1], gyr[k, 2])
        turn = exp((w[0] * dt, w[1] * dt, w[2] * dt))
        a = unit((acc[k, 0], acc[k, 1], acc[k, 2]))
        before = unit((acc[k - 1, 0], acc[k - 1, 1], acc[k - 1, 2]))
        off = norm(subtract(a, rotate_inverse(turn, before)))
        gravity += 0.5 * off * off
        change = norm(subtract(w, (gyr[k - 1, 0], gyr[k - 1, 1], gyr[k - 1, 2])))
        gyroscope += 0.5 * change * change
        steps += 1
        if has_mag[k]:
            m = (mag[k, 0], mag[k, 1], mag[k, 2])
            if last == k - 1:
                was = unit((mag[last, 0], mag[last, 1], mag[last, 2]))
                off = norm(subtract(unit(m), rotate_inverse(turn, was)))
                magnetic += 0.5 * off * off
                strength += norm(m)
                cosine -= dot(unit(m), a)
                fields += 1
            last = k
    return gravity, magnetic, gyroscope, strength, cosine, steps, fields


def noise_of(readings: Readings, first: int = 0) -> Noise | None:
    """The noise of the readings from ``first`` on; None if they come too slowly to tell."""
    gravity, magnetic, gyroscope, strength, cosine, steps, fields = _sums(readings, first)
    if steps < (len(readings.time_s) - first) // 2:
        return None
    seen = max(fields, 1)
    return Noise(
        gravity=gravity / steps,
        magnetic=magnetic / seen,
        gyroscope=gyroscope / steps,
        strength=strength / seen,
        angle_rad=float(np.arccos(np.clip(cosine / seen, -1.0, 1.0))),
    )


def has_moved(learnt: Noise, now: Noise) -> bool:
    """Whether any noise is another than was learnt."""
    return any(
        abs(log((new + LEAST) / (old + LEAST))) > log(CHANGED)
        for old, new in zip(learnt[:3], now[:3], strict=True)
    )


def is_disturbed(learnt: Noise, now: Noise) -> bool:
    """Whether the field is another than was learnt: a magnet, or iron nearby."""
    if learnt.strength == 0.0:
        return False
    share = now.strength / learnt.strength
    angle = abs(now.angle_rad - learnt.angle_rad)
    return abs(share - 1.0) > FIELD_CHANGED or angle > ANGLE_CHANGED_RAD
