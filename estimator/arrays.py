"""Names for kinds of arrays; their shapes are given where they are used."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Times = Ints  # us


def writable(values: Floats) -> Floats:
    """The array, copied where it is constant or not contiguous: kernels have one form for it."""
    return np.require(values, requirements=("C", "W"))
