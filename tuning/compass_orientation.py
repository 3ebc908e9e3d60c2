"""How a compass is turned in its vehicle, by right angles, from the field that it should see."""

from itertools import permutations, product

import numpy as np

from estimator.arrays import Floats

LEAST_READINGS = 50
# A right angle moves the field's horizontal part by more than this share of its strength where the
# vehicle turns; less shows nothing, and is iron.
LEAST_MISFIT = 0.15
CLEAR = 0.5  # of the misfit of any other way, at most

# The signed permutations of axes; as given first.
TURNS: Floats = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
RIGHT_ANGLED: Floats = TURNS[np.linalg.det(TURNS) > 0.0]  # the first turns nothing


def compass_turn(mag_gauss: Floats, expected_gauss: Floats) -> Floats | None:
    """The rotation (3, 3) that takes readings (N, 3) into the body's axes; None for none.

    ``expected_gauss`` (N, 3) is the place's field in the body's axes by an attitude whose heading
    the compass has not shown. A constant offset is left to the search for iron.
    """
    if len(mag_gauss) < LEAST_READINGS:
        return None
    misfits = np.array([_misfit(mag_gauss, expected_gauss @ R) for R in RIGHT_ANGLED])
    best, second = (int(k) for k in np.argsort(misfits)[:2])
    strength = float(np.median(np.linalg.norm(expected_gauss, axis=1)))
    is_clear = misfits[best] < CLEAR * misfits[second]
    if best == 0 or not is_clear or misfits[0] < LEAST_MISFIT * strength:
        return None
    turn: Floats = RIGHT_ANGLED[best]
    return turn


def _misfit(mag: Floats, seen: Floats) -> float:
    """Median distance between readings and what would be seen, beyond a constant offset."""
    off = mag - seen
    return float(np.median(np.linalg.norm(off - np.median(off, axis=0), axis=1)))
