"""A replay's attitudes with those in their places that the whole log shows."""

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
    at = np.searchsorted(times_us, trace["time_us"])
    trace.table.put("q_ned_frd", [now.q_ned_frd[at]])
    trace.table.put("rate_rad_s", [now.rate_rad_s[at]])
    trace.table.put("gyro_bias_rad_s", [now.bias_rad_s[at]])
    trace.table.put("sigma_inclination_rad", [now.sigma_rad[at, 0]])
    trace.table.put("sigma_heading_rad", [now.sigma_rad[at, 1]])
    north = trace["heading_reference"]
    trace.table.put("heading_reference", [np.full_like(north, north[-1])])
