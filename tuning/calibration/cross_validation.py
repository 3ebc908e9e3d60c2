"""Which constants do other readings agree with than those that they were fitted to?

Parts of the recordings are left out in turn. A key of the profile is kept if it, or both keys of
its sensor together, fitted to all other parts, win half of what they would win fitted to each piece
of the part. What a piece shows is x.A x / 2 - b.x, its loss by constants x (36,) in units of their
sigmas before; the pieces' scatter counts in it.
"""

from collections.abc import Iterable

import numpy as np

from estimator.types import Floats, Ints
from tuning.calibration.spans import CONSTANTS, cross_matrix

KEYS = {
    "gyr_bias_rad_s": slice(9, 12),
    "gyr_matrix": slice(0, 9),
    "acc_bias_m_s2": slice(21, 24),
    "acc_matrix": slice(12, 21),
    "mag_offset_gauss": slice(33, 36),
    "mag_matrix": slice(24, 33),
}
SENSORS = ("gyr", "acc", "mag")  # the keys of each begin so
# What lags of velocity and iron all around, alike in all parts of a flight, do not look like
IN_FLIGHT = ("gyr_bias_rad_s",)
WON = 0.5
LEAST_TO_WIN = 6.0  # of the losses' sum: by less it is chance
ROWS = np.arange(CONSTANTS)
PINNED, NO_LOSS = 1e6, 1e-6
_TURN, _NONE = cross_matrix(np.eye(3)).reshape(3, 9), np.zeros((3, 3))
# The constants of a small turn of all three sensors about each axis
COMMON_TURNS: Floats = np.concatenate([_TURN, _NONE, _TURN, _NONE, -_TURN, _NONE], axis=1).T


def predicted(
    A: Floats, b: Floats, parts: Ints, prior: Floats, keys: Iterable[str]
) -> tuple[dict[str, float], Floats]:
    """The share that each key wins, and the constants (36,) by those that are kept.

    Of pieces (K,) ``A`` (K, 36, 36), ``b`` (K, 36) and the part that each belongs to. Keys go one
    by one, that which wins least first: what it has explained falls to others. Others than
    ``keys`` are not sought, and have no share.
    """
    shares, kept = dict[str, float](), list(keys)
    pins = COMMON_TURNS / prior[:, None]
    while kept:
        for sensor in SENSORS:
            both = [key for key in kept if key.startswith(sensor)]
            if both:
                shares |= dict.fromkeys(both, _share(A, b, parts, pins, kept, both))
            for key in both if len(both) > 1 else ():
                shares[key] = max(shares[key], _share(A, b, parts, pins, kept, [key]))
        worst = min(kept, key=shares.__getitem__)
        if shares[worst] >= WON:
            break
        kept.remove(worst)
    return shares, _solved(A.sum(axis=0), b.sum(axis=0), pins, kept)


def _share(
    A: Floats, b: Floats, parts: Ints, pins: Floats, kept: list[str], judged: list[str]
) -> float:
    at, gains, most = np.concatenate([ROWS[KEYS[key]] for key in judged]), 0.0, 0.0
    others = [each for each in kept if each not in judged]
    for part in np.unique(parts):
        is_left_out = parts == part
        rest = A[~is_left_out].sum(axis=0), b[~is_left_out].sum(axis=0)
        full, without = (_solved(*rest, pins, keys) for keys in (kept, others))
        for H, g in zip(A[is_left_out], b[is_left_out], strict=True):
            gains += _loss(H, g, without) - _loss(H, g, full)
            slope = (g - H @ without)[at]
            own = H[np.ix_(at, at)] + NO_LOSS * np.eye(len(slope))
            most += 0.5 * float(slope @ np.linalg.solve(own, slope))
    return gains / max(most, LEAST_TO_WIN)


def _loss(H: Floats, g: Floats, x: Floats) -> float:
    return float(0.5 * x @ H @ x - g @ x)


def _solved(A: Floats, b: Floats, pins: Floats, kept: list[str]) -> Floats:
    """The constants (36,) of some keys, others 0.

    A sensor without its matrix may be turned against the others while those are sought, or they
    would turn with it.
    """
    rows = np.zeros(CONSTANTS, np.bool_)
    for key in kept:
        rows[KEYS[key]] = True
    turns = [
        np.where(np.isin(ROWS, ROWS[at])[:, None], pins, 0.0)
        for key, at in KEYS.items()
        if "matrix" in key and key not in kept
    ]
    ways = np.column_stack([np.eye(CONSTANTS)[:, rows], *turns])
    ways /= np.linalg.norm(ways, axis=0)
    pinned = pins / np.linalg.norm(pins, axis=0)
    H = A + np.eye(CONSTANTS) + PINNED * pinned @ pinned.T
    x: Floats = ways @ np.linalg.solve(ways.T @ H @ ways, ways.T @ b)
    return np.where(rows, x, 0.0)
