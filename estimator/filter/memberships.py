"""The 22 numbers that shape the fuzzy sets: names, bounds and feasibility.

The paper's Eqs. (16) "Inp_MMF_Constraints" and (17) "Out_MMF_Constraints", drawn in its Figs. 4
"FLC_Inp_MMF" and 5 "FLC_Out_MMF". Sets are in the order VS, S, M, L, VL (very small ... very
large).
"""

from itertools import pairwise
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.errors import InputError

Triangle = tuple[float, float, float]
Five = tuple[Triangle, Triangle, Triangle, Triangle, Triangle]
Memberships = tuple[float, ...]  # k1 .. k22

NAMES = tuple(f"k{i}" for i in range(1, 23))
TERMS = ("VS", "S", "M", "L", "VL")

# Lower and upper bounds of k1..k11 (inputs, on [0, 1]) and k12..k22 (output, on [0, 100]).
LOWER: Memberships = (
    *(0.0, 0.0, 0.0, 0.1, 0.05, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2),
    *(0.0, 0.0, 5.0, 10.0, 5.0, 20.0, 20.0, 20.0, 20.0, 40.0, 40.0),
)
UPPER: Memberships = (
    *(0.15, 0.2, 0.2, 0.2, 0.2, 0.25, 0.35, 0.35, 0.5, 0.7, 0.7),
    *(15.0, 20.0, 20.0, 30.0, 20.0, 50.0, 50.0, 50.0, 70.0, 90.0, 70.0),
)

# Indices (from 0) of each triangle's free corners; the order a <= b <= c holds within each.
CHAINS: tuple[tuple[int, ...], ...] = (
    *((0,), (1, 2, 3), (4, 5, 6), (7, 8, 9), (10,)),
    *((11,), (12, 13, 14), (15, 16, 17), (18, 19, 20), (21,)),
)


class FuzzySets(NamedTuple):
    """Five triangles (a, b, c) for both inputs and five for the output."""

    inputs: Five
    output: Five


@inlined
def fuzzy_sets(k: Memberships) -> FuzzySets:
    """Lay k1..k22 out as triangles, as the paper's constraint blocks do."""
    return FuzzySets(
        inputs=(
            (0.0, 0.0, k[0]),
            (k[1], k[2], k[3]),
            (k[4], k[5], k[6]),
            (k[7], k[8], k[9]),
            (k[10], 1.0, 1.0),
        ),
        output=(
            (0.0, 0.0, k[11]),
            (k[12], k[13], k[14]),
            (k[15], k[16], k[17]),
            (k[18], k[19], k[20]),
            (k[21], 100.0, 100.0),
        ),
    )


def require_feasible(k: Memberships) -> None:
    """Check count, bounds and the order within each triangle.

    Raises:
        InputError: naming the first parameter that is out of place.
    """
    if len(k) != len(NAMES):
        raise InputError(f"membership: {len(NAMES)} numbers k1..k22 are needed, got {len(k)}")
    for name, value, low, high in zip(NAMES, k, LOWER, UPPER, strict=True):
        if not low <= value <= high:
            raise InputError(f"membership.{name}: {value:g} is outside [{low:g}, {high:g}]")
    for chain in CHAINS:
        for left, right in pairwise(chain):
            if k[left] > k[right]:
                raise InputError(
                    f"membership: {NAMES[left]} <= {NAMES[right]} must hold within a triangle, "
                    f"got {k[left]:g} > {k[right]:g}"
                )


def midpoint() -> Memberships:
    """The middle of the bounds; feasible, because both ends are ordered."""
    return tuple(0.5 * (low + high) for low, high in zip(LOWER, UPPER, strict=True))
