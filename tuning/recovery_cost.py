"""The paper's cost on a flight: how an estimate that is suddenly wrong comes back.

Every 14 s the filter is given the true attitude turned by 170 deg about NED (1,1,1)/sqrt 3, next
to the unstable equilibrium; the conditioning stage and the aiding go on.
"""

from math import radians

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import exp, multiply, scale
from estimator.profile import Profile
from estimator.types import Quaternion
from tuning.flight import Part, fly
from tuning.segments import Segment, segments, weights

Array = NDArray[np.float64]

# Next to the unstable equilibrium, as the paper starts: e = 0.992.
WRONG_TURN = exp(scale(radians(170.0), (3**-0.5, 3**-0.5, 3**-0.5)))
# An estimate that is no number is as wrong as can be.
WORST_ERROR = 1.0


def recovery_cost(profile: Profile, part: Part) -> float:
    """Mean J over the part's segments; without a magnetic field the inclination alone counts.

    Raises:
        InputError: the part has no segment.
    """
    found = require_segments(part)
    errors = recovery_errors(profile, part, found)
    costs = [
        float(weights(part.flight, segment) @ errors[segment.first : segment.last + 1])
        for segment in found
    ]
    return sum(costs) / len(costs)


def recovery_errors(profile: Profile, part: Part, found: list[Segment]) -> Array:
    """e (N,) at each sample up to the part's end: sin^2 of half the error."""
    flight = part.flight
    wrong = {first: multiply(WRONG_TURN, _row(flight.truth[first])) for first, _ in found}
    course = fly(flight, profile, part.last, wrong)
    angles = batch_angle_errors(course.q_ned_frd, flight.truth[: part.last])
    e = np.sin(0.5 * angles[:, 0 if flight.has_field else 2]) ** 2
    return np.where(np.isfinite(e), e, WORST_ERROR)


def _row(q: Array) -> Quaternion:
    w, x, y, z = q.tolist()
    return w, x, y, z


def require_segments(part: Part) -> list[Segment]:
    """The part's segments.

    Raises:
        InputError: there is none.
    """
    found = segments(part)
    if not found:
        raise InputError(
            f"{part.flight.name}: no stretch of 14 s without gaps and with a reference "
            "in what is to be tuned on or held out"
        )
    return found
