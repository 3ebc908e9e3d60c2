"""What turns have shown of the iron around a compass that nobody has calibrated."""

from math import sqrt

import numpy as np

from estimator.aiding import compass
from estimator.aiding.search import UNKNOWN_RAD
from estimator.conditioning.field.calibration import most_variances
from estimator.conditioning.field.magnetic import norm_of
from estimator.live.state import State


def unshown_iron_rad(state: State) -> float:
    """How far (rad) iron that nothing has shown may turn the heading; ``UNKNOWN_RAD`` at most.

    0 for a trusted compass. Of one without a calibration the turns' own information counts, which
    is that of the learnt offset (:mod:`estimator.conditioning.field.calibration`) less the one
    supposed before: s = norm / (H sqrt l), l its least eigenvalue. Against what else is doubted
    turns say nothing.
    """
    if state.trusts_compass:
        return 0.0
    known, now = state.context.compass, state.core.core.conditioning.field
    declared = known._replace(declared_calibrated=True)
    reference, most = now.magnetic.reference, most_variances(state.settings.conditioning)[0]
    h, norm = reference.horizontal, norm_of((reference.horizontal, reference.down))
    has_field = state.settings.conditioned and most > 0.0 and h > 0.0
    if not has_field or not compass.is_trusted(declared, state.core.time_us):
        return UNKNOWN_RAD
    xx, xy, xz, _, yy, yz, _, zz, *_ = now.calibration.learnt.covariance
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shown = np.linalg.inv(covariance) - np.eye(3) / most
    least = float(np.linalg.eigvalsh(shown)[0])
    return min(UNKNOWN_RAD, norm / (h * sqrt(least))) if least > 0.0 else UNKNOWN_RAD
