"""Compile all kernels before the first sample comes, not when it is there.

The kernels are two halves of about the same size, which two processes compile
at the same time; what the second one compiles, the first then finds in the
cache.
"""

import atexit
import importlib
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from estimator.aiding import begin
from estimator.aiding.phase import Phase
from estimator.aiding.types import NO_REPORT
from estimator.compilation.compiled import is_cached
from estimator.estimator import Estimator
from estimator.live import resident
from estimator.live.core import flat
from estimator.live.settings import settings_of
from estimator.profile import Profile, load_profile
from estimator.types import IDENTITY, ZERO_VEC3, ImuSample, VelocitySample

STEP_US = 10_000
BLAS = "scipy.linalg.cython_blas"
HELPER_S = 600.0  # longer than it takes on a busy computer; after that we compile its half, too
HERE: tuple[Any, ...] = (
    resident.advance,
    resident.publish,
    resident.resident,
    resident.contents,
)
ELSEWHERE: tuple[Any, ...] = (
    resident.advance_aided,
    resident.hear,
    resident.search,
    *resident.hearings(),
)
# What the helper runs. It imports our packages from where they are, and nothing from the folder
# that the command was started in, which may hold anybody's downloads: -P keeps that off the path.
OUR_FOLDER = Path(__file__).resolve().parents[1]
HELPER = (
    "import sys; sys.path.insert(0, sys.argv[1]); from service import warm_up; warm_up.help_out()"
)


def warm_up(profile: Profile, gain: float | None) -> None:
    """Compile the kernels now, so that neither the first sample nor the first velocity waits.

    For a process of the service's own: its kernels cannot use SciPy's linear algebra afterwards.
    """
    _leave_out_scipy()
    needs_aided = _needs_aided(profile)
    if needs_aided and is_cached(resident.advance_aided) is False:
        with _compile_elsewhere():
            compile_ahead(profile, HERE)
    rehearse(Estimator(profile, gain), aided=needs_aided)


def is_compiled(profile: Profile) -> bool:
    """Whether nothing is left to be compiled for the profile's samples: all lies in the cache."""
    _leave_out_scipy()
    kernels = HERE + (ELSEWHERE if _needs_aided(profile) else ())
    return all(is_cached(kernel) for kernel in kernels)


def _needs_aided(profile: Profile) -> bool:
    chosen = settings_of(profile)
    return chosen.conditioned and chosen.aiding.enabled


def _leave_out_scipy() -> None:
    """Have numba begin without SciPy's BLAS, which no kernel of ours uses.

    To load it takes as long as loading all kernels, and on a cold disk longer.
    """
    if BLAS in sys.modules:
        return
    sys.modules[BLAS] = None  # type: ignore[assignment] # to import it fails, and numba goes on
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules[BLAS]


def compile_ahead(profile: Profile, kernels: tuple[Any, ...]) -> None:
    """Compile these kernels without running them."""
    arguments = resident.arguments_of(settings_of(profile), Estimator(profile).snapshot.core)
    for kernel in kernels:
        kernel.compile(arguments[kernel])


def help_out() -> None:
    """Compile the helper's half into the cache."""
    compile_ahead(load_profile("imu"), ELSEWHERE)


def rehearse(estimator: Estimator, *, aided: bool) -> None:
    """Run a few samples and velocities, which compiles what is still missing."""
    for number in range(3):
        estimator.update(_sample(number))
        estimator.update_velocity(_report(number))  # heard at the next sample
    estimator.attitude(3 * STEP_US)
    if not aided:
        return
    before = estimator.snapshot
    aiding = settings_of(estimator.profile).aiding
    core = before.core
    state, covariance, trail = begin(
        aiding,
        q_ned_frd=IDENTITY,
        gyr_bias=ZERO_VEC3,
        sample=core.sample,
        report=NO_REPORT,
        tilt_sigma_rad=0.1,
        heading_sigma_rad=0.1,
        hard_iron_sigma_gauss=0.0,
    )
    estimator.snapshot = before._replace(
        core=core._replace(aided=state, covariance=flat(covariance), trail=flat(trail)),
        context=before.context._replace(phase=Phase.AIDED),
    )
    estimator.update(_sample(3))
    estimator.update_velocity(_report(3))  # it belongs to the last sample
    estimator.attitude(4 * STEP_US)


def _report(number: int) -> VelocitySample:
    return VelocitySample(number * STEP_US, ZERO_VEC3, True, 0.1)


def _sample(number: int) -> ImuSample:
    return ImuSample(
        time_us=number * STEP_US,
        gyr_rad_s=ZERO_VEC3,
        acc_m_s2=(0.0, 0.0, -9.8),
        mag_gauss=(0.2, 0.0, 0.4),
        has_mag=True,
    )


@contextmanager
def _compile_elsewhere() -> Iterator[None]:
    """Have another process compile the other half into the cache meanwhile."""
    helper = subprocess.Popen(  # noqa: S603 - our own arguments
        [sys.executable, "-P", "-c", HELPER, str(OUR_FOLDER)],
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
