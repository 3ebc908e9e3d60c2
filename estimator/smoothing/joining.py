"""Two estimates of the same attitudes as one: forward and backward."""

import numpy as np

from estimator.arrays import Bools
from estimator.geometry.rotations import conjugate, exp, log, multiply
from estimator.live.rows import blocks
from estimator.smoothing.recording import Estimates

# Further apart than so many of their sigmas one of both is wrong.
CONTRADICTION = 3.0


def join(forward: Estimates, backward: Estimates) -> Estimates:
    """The joint estimates, in the room of the backward ones."""
    for rows in blocks(len(backward.is_aided)):
        joint = joined(forward.part(rows), backward.part(rows))
        for now, before in zip(joint, backward, strict=True):
            before[rows] = now
    return backward


def joined(forward: Estimates, backward: Estimates) -> Estimates:
    """The mean by both variances, of inclination and heading apart.

    Their errors have much in common, so that sigma is the mean of both. Where they contradict each
    other it is half of what is between them at least. Where velocity helps one of them alone, or
    one is not known, the other does not count.
    """
    one, other = forward.sigma_rad, backward.sigma_rad
    apart = log(multiply(backward.q_ned_frd, conjugate(forward.q_ned_frd)))
    between = np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=-1)
    share = one**2 / (one**2 + other**2)
    sigma = (1.0 - share) * one + share * other
    contradicts = between > CONTRADICTION * np.hypot(one, other)
    sigma = np.where(contradicts, np.maximum(sigma, 0.5 * between), sigma)
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
