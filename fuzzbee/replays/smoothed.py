"""A replay's attitudes with those in their places that the whole log tells."""

from collections.abc import Callable

import numpy as np

from estimator.estimator import Estimator
from estimator.profile import Profile
from fuzzbee.replays.trace import VehicleTrace


def recorder(fixed_gain: float | None) -> Callable[[Profile], Estimator]:
    """What makes an estimator that can be smoothed; SciPy is loaded by then only."""
    from estimator.smoothing import Recorder

    return lambda profile: Recorder(profile, fixed_gain)


def smooth_trace(trace: VehicleTrace, estimator: Estimator | None) -> None:
    """Put the smoothed attitudes into the trace; what the end knows of north holds for all."""
    from estimator.smoothing import Recorder, smooth_all

    assert isinstance(estimator, Recorder)
    times_us, now = smooth_all(estimator)
    at = np.searchsorted(times_us, trace.times_us)
    inclination, heading = now.sigma_rad.T
    for name, values in (
        ("q_ned_frd", now.q_ned_frd),
        ("rate_rad_s", now.rate_rad_s),
        ("gyro_bias_rad_s", now.bias_rad_s),
        ("sigma_inclination_rad", inclination),
        ("sigma_heading_rad", heading),
    ):
        trace.attitudes.replace(name, values[at])
    north = trace.attitudes.column("heading_reference")
    trace.attitudes.replace("heading_reference", np.full_like(north, north[-1]))
