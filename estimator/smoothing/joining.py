"""Two estimates of the same attitudes as one: forward and backward."""

import numpy as np

from estimator.arrays import Bools
from estimator.geometry.rotations import conjugate, exp, log, multiply
from estimator.live.rows import blocks
from estimator.smoothing.recording import Estimates


def join(forward: Estimates, backward: Estimates) -> Estimates:
    """The joint estimates, in the room of the backward ones."""
    for rows in blocks(len(backward.is_aided)):
        joint = joined(forward.part(rows), backward.part(rows))
        for now, before in zip(joint, backward, strict=True):
            before[rows] = now
    return backward


def joined(forward: Estimates, backward: Estimates) -> Estimates:
    """The mean by both variances, of inclination and heading apart.

    With velocity each has learnt from what the other has not: sigma is that of independent errors;
    without it both err by the same field, so it is the mean of both. Further apart than their
    sigmas allow, it grows by as much (R. T. Birge 1932, Phys. Rev. 40, 207). Where velocity helps
    one of them alone, or one is not known, the other does not count.
    """
    one, other = forward.sigma_rad, backward.sigma_rad
    apart = log(multiply(backward.q_ned_frd, conjugate(forward.q_ned_frd)))
    between = np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=-1)
    expected = np.hypot(one, other)
    share = (one / expected) ** 2
    least = np.where(forward.is_aided[:, None], 1.0, (one + other) / expected)
    sigma = one * other / expected * np.maximum(least, between / expected)
    turn = apart * share[:, [0, 0, 1]]
    both = Estimates(multiply(exp(turn), forward.q_ned_frd), sigma, forward.is_aided)
    both = chosen(forward.is_aided & ~backward.is_aided, forward, both)
    both = chosen(backward.is_aided & ~forward.is_aided, backward, both)
    return fallback(fallback(both, forward), backward)


def fallback(first: Estimates, second: Estimates) -> Estimates:
    """The first, and where that is not known the second."""
    known = known_rows(first)
    return first if known.all() else chosen(known, first, second)


def known_rows(estimates: Estimates) -> Bools:
    """Where there is an attitude with its sigmas (N,)."""
    numbers = (estimates.q_ned_frd, estimates.sigma_rad)
    return np.asarray(np.all([np.isfinite(each).all(axis=1) for each in numbers], axis=0))


def chosen(rows: Bools, first: Estimates, second: Estimates) -> Estimates:
    """The first where ``rows`` (N,) say so, else the second."""
    if not rows.any():
        return second
    return Estimates(
        np.where(rows[:, None], first.q_ned_frd, second.q_ned_frd),
        np.where(rows[:, None], first.sigma_rad, second.sigma_rad),
        np.where(rows, first.is_aided, second.is_aided),
    )
