"""Compile before the first sample, not at it."""

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample

STEP_US = 10_000


def warm_up(profile: Profile, gain: float | None) -> None:
    """Compile the kernels now: the first sample must not wait for it, nor the first velocity."""
    estimator = Estimator(profile, gain)
    estimator.set_position(0.0, 0.0, 0.0, 0)
    for number in range(3):
        time_us = number * STEP_US
        estimator.update(ImuSample(time_us, ZERO_VEC3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True))
        # the first one begins the aiding at the next sample, the others come behind theirs
        estimator.update_velocity(VelocitySample(time_us, ZERO_VEC3, True, 0.1))
    estimator.attitude(3 * STEP_US)
