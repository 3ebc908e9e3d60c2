"""Many samples and what is said about them, as rows of numbers in arrays."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

# Columns of a row of readings: rate, specific force, field (FRD), and 1 where there is a field.
READINGS = 10
# Columns of a row that tells an attitude: q_ned_frd, rate, bias, e, its rate, K, the confidences
# of gravity and field, the sigmas of inclination and heading, and 1 where a field has told one.
SAID = 18
HAS_HEADING = 17
