"""A replay's attitudes with those in their places that the whole log tells."""

from collections.abc import Callable

import numpy as np

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.types import Attitude
from fuzzbee.replays.trace import VehicleTrace


def recorder(fixed_gain: float | None) -> Callable[[Profile], Estimator]:
    """What makes an estimator that can be smoothed; SciPy is loaded by then only."""
    from estimator.smoothing import Recorder

    return lambda profile: Recorder(profile, fixed_gain)


def smoothed(trace: VehicleTrace, estimator: Estimator | None) -> list[Attitude]:
    """The attitudes at the trace's samples; what the end knows of north holds for all."""
    from estimator.smoothing import Recorder, smooth_all

    assert isinstance(estimator, Recorder)
    times_us, now = smooth_all(estimator)
    at = np.searchsorted(times_us, trace.times_us)
    north = trace.attitudes[-1].heading_reference
    columns = (column[at].tolist() for column in now)
    rows = zip(trace.attitudes, *columns, strict=True)
    return [
        said._replace(
            q_ned_frd=tuple(q),
            rate_rad_s=tuple(rate),
            gyro_bias_rad_s=tuple(bias),
            sigma_inclination_rad=sigma[0],
            sigma_heading_rad=sigma[1],
            heading_reference=north,
        )
        for said, q, sigma, rate, bias in rows
    ]
