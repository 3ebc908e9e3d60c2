"""Compile before the first sample, not at it.

With velocity aiding that is two halves of about the same size, which two
processes compile at the same time; what the second one compiles, the first
then finds in the cache.
"""

import atexit
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from estimator.aiding import begin
from estimator.compiled import is_cached
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile
from estimator.reports import NO_REPORT
from estimator.settings import settings_of
from estimator.types import IDENTITY, ZERO_VEC3, ImuSample, VelocitySample

STEP_US = 10_000
HELPER_S = 120.0  # far longer than it takes; then it is compiled here
AIDED_KERNEL = "advance_aided"


def warm_up(profile: Profile, gain: float | None) -> None:
    """Compile the kernels now: the first sample must not wait for it, nor the first velocity."""
    estimator = Estimator(profile, gain)
    chosen = settings_of(profile)
    needs_aided = chosen.conditioned and chosen.aiding.enabled
    with _compiled_elsewhere(needed=needs_aided):
        for number in range(3):
            estimator.update(_sample(number))
        estimator.attitude(3 * STEP_US)
        estimator.snapshot  # noqa: B018 - taking the state out is compiled, too
    if needs_aided:
        warm_up_aided(estimator)


def warm_up_aided(estimator: Estimator) -> None:
    """The kernels that velocity needs, without those that it does not."""
    if not estimator.aligned:
        estimator.update(_sample(0))
    aiding = settings_of(estimator.profile).aiding
    state, covariance = begin(
        aiding, IDENTITY, ZERO_VEC3, ZERO_VEC3, ZERO_VEC3, NO_REPORT, 0.1, 0.0
    )
    before = estimator.snapshot
    estimator.snapshot = before._replace(
        aided=state, aided_covariance=tuple(covariance.ravel().tolist())
    )
    number = before.time_us // STEP_US + 1
    estimator.update(_sample(number))
    estimator.update_velocity(VelocitySample(number * STEP_US, ZERO_VEC3, True, 0.1))
    estimator.attitude((number + 1) * STEP_US)


def _sample(number: int) -> ImuSample:
    return ImuSample(number * STEP_US, ZERO_VEC3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)


@contextmanager
def _compiled_elsewhere(*, needed: bool) -> Iterator[None]:
    """Meanwhile another process compiles the aided kernels, if they are not cached but can be."""
    if not needed or is_cached(AIDED_KERNEL) is not False:
        yield
        return
    helper = subprocess.Popen(
        [sys.executable, "-m", "service.warm_up"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    atexit.register(helper.kill)
    try:
        yield
        helper.wait(HELPER_S)
    except subprocess.TimeoutExpired:
        pass  # it is compiled here, then
    finally:
        helper.kill()
        helper.wait()
        atexit.unregister(helper.kill)


if __name__ == "__main__":
    warm_up_aided(Estimator(load_profile("imu")))
