"""Compile before the first sample, not at it."""

from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.types import ImuSample


def warm_up(profile: Profile, gain: float | None) -> None:
    """Compile the kernels now: the first sample must not wait for it."""
    estimator = Estimator(profile, gain)
    for number in range(3):
        estimator.update(
            ImuSample(number * 10_000, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)
        )
    estimator.attitude(30_000)
