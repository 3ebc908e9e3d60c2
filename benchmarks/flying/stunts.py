"""Calm flights with two stretches of rolls and loops: the truth of ``aerobatics.py``."""

from math import pi
from typing import NamedTuple

import numpy as np
from flying.motions import DT, Moment, Vehicle, calm_copter, plane

from estimator.geometry.quaternion import add, scale, subtract
from estimator.types import ZERO_VEC3, Quaternion, Vec3

STRETCHES_S = ((70.0, 95.0), (140.0, 165.0))
CALM_LEGS = ("straight", "straight", "bank 15", "bank -20")
# By axis how fast, rad/s: a plane rolls faster than it loops, a copter flips either way.
RATES = {"plane": ((1.5, 5.0), (0.8, 1.3)), "copter": ((4.0, 8.0), (4.0, 8.0))}
FOLLOWS_S = 0.1


class Stunt(NamedTuple):
    """One, two or three whole turns about one axis of the body."""

    begin_s: float
    end_s: float
    rate: Vec3  # rad/s


def stunts(kind: str, seed: int) -> list[Stunt]:
    """All of a flight, none begun outside the stretches."""
    rng, found = np.random.default_rng(10_000 + seed), []
    for begin_s, end_s in STRETCHES_S:
        t = begin_s
        while t < end_s:
            axis = int(rng.random() < 1.0 / 3.0)
            fast = float(rng.uniform(*RATES[kind][axis]))
            turns = 1 if axis == 1 else int(rng.integers(1, 4))
            signed = fast if axis == 1 and kind == "plane" else fast * float(rng.choice((-1, 1)))
            length_s = turns * 2.0 * pi / fast
            found.append(Stunt(t, t + length_s, (0.0, signed, 0.0) if axis else (signed, 0.0, 0.0)))
            t += length_s + float(rng.uniform(0.5, 3.0))
    return found


def ends_s(kind: str, seed: int) -> list[float]:
    """When the last turn of each stretch is over."""
    ends = [stunt.end_s for stunt in stunts(kind, seed)]
    return [max(t for t in ends if t < begin_s + 60.0) for begin_s, _ in STRETCHES_S]


def aerobat(kind: str, seed: int) -> Vehicle:
    """The calm vehicle of a kind that turns as its stunts say while they last."""
    calm, heading = plane(seed, CALM_LEGS) if kind == "plane" else calm_copter(seed)
    left, extra = stunts(kind, seed), ZERO_VEC3

    def step(q: Quaternion, t: float) -> Moment:
        nonlocal extra
        now = calm(q, t)
        while left and left[0].end_s <= t:
            left.pop(0)
        wanted = ZERO_VEC3
        if left and left[0].begin_s <= t:
            wanted = subtract(left[0].rate, now.rate)
        extra = add(extra, scale(DT / FOLLOWS_S, subtract(wanted, extra)))
        return now._replace(rate=add(now.rate, extra))

    return step, heading
