"""Compile all kernels before the first sample comes, or beside the service while it interprets.

The kernels are two halves of about the same size, which two processes compile at the same time;
the service then finds them in the cache.
"""

import ctypes
import importlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from drivers.samples import sensor_faults, vehicle_clock
from estimator.aiding import begin
from estimator.aiding.phase import Phase
from estimator.aiding.types import NO_REPORT
from estimator.compilation.compiled import is_cached, is_compiled_code
from estimator.compilation.direct import direct
from estimator.estimator import Estimator
from estimator.live import resident
from estimator.live.core import flat
from estimator.live.settings import settings_of
from estimator.profile import Profile, load_profile
from estimator.types import IDENTITY, ZERO_VEC3, ImuSample, VelocitySample
from service import attitude_text, usual_rows, usual_vehicles
from service.offspring import is_stopped

STEP_US = 10_000
BLAS = "scipy.linalg.cython_blas"
HELPER_S = 1800.0  # longer than it takes on a busy computer; after that the service compiles
LOOK_S = 1.0  # whether somebody has stopped it
NICENESS = 5  # of the helpers: the service's ticks come first
UNAIDED: tuple[Any, ...] = (
    resident.resident,
    resident.contents,
    resident.clock,
    resident.contradicted_axes,
    resident.hear_rate,
    resident.turn_on,
    resident.turning_of,
    resident.lay,
    resident.publish,
    resident.advance_raw,
    resident.advance,
    sensor_faults.judge_reading,
    vehicle_clock.place_message,
    usual_rows.new_fleet,
    usual_rows.put,
    usual_rows.take_rows,
    usual_rows.show_rows,
    attitude_text.write_texts,
)
FOR_VELOCITY: tuple[Any, ...] = (
    resident.advance_aided,
    resident.hear,
    resident.search,
    *resident.hearings(),
)
# What a helper runs. It imports our packages from where they are, and nothing from the folder
# that the command was started in, which may hold anybody's downloads: -P keeps that off the path.
OUR_FOLDER = Path(__file__).resolve().parents[1]
HELPER = (
    "import sys; sys.path.insert(0, sys.argv[1]); from service import offspring; "
    "offspring.end_with_parent(); from service import warm_up; warm_up.help_out(warm_up.{half})"
)


def warm_up(profile: Profile, gain: float | None) -> None:
    """Compile or load the kernels now, so that neither the first sample nor a velocity waits.

    For a process of the service's own: its kernels cannot use SciPy's linear algebra afterwards.
    """
    with helpers(profile) as started:
        for helper in started:
            await_end(helper)
    if is_compiled_code():
        for kernel, types in _of_edges().items():
            direct(kernel, types)
    rehearse(Estimator(profile, gain), aided=_needs_aided(profile))
    _give_back()


def _give_back() -> None:
    """Give the system what loading has freed, 9 MB; only the GNU C library has to be told."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def is_compiled(profile: Profile) -> bool:
    """Whether nothing is left to be compiled for the profile's samples: all lies in the cache."""
    kernels = [kernel for half in _halves(profile).values() for kernel in half]
    return all(is_cached(kernel) for kernel in kernels)


def is_kept() -> bool:
    """Whether compiled code can be kept, so that another process can make it for this one."""
    return is_cached(resident.advance) is not None


def _halves(profile: Profile) -> dict[str, tuple[Any, ...]]:
    """The kernels that the profile's samples need, by the name here of their half."""
    halves = {"UNAIDED": UNAIDED}
    return {**halves, "FOR_VELOCITY": FOR_VELOCITY} if _needs_aided(profile) else halves


def _lacks(kernels: tuple[Any, ...]) -> bool:
    """Whether the cache lacks one of them; where there is no cache nothing is said to lack."""
    return any(is_cached(kernel) is False for kernel in kernels)


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


def _of_edges() -> dict[Any, tuple[Any, ...]]:
    """The kernels of links and sinks, and the types that they are called with."""
    return {
        sensor_faults.judge_reading: sensor_faults.argument_types(),
        vehicle_clock.place_message: vehicle_clock.argument_types(),
        attitude_text.write_texts: attitude_text.argument_types(),
    }


def compile_ahead(profile: Profile, kernels: tuple[Any, ...]) -> None:
    """Compile these kernels without running them."""
    arguments = resident.arguments_of(settings_of(profile), Estimator(profile).snapshot.core)
    (inside,) = arguments[resident.contents]
    arguments |= _of_edges() | usual_vehicles.argument_types(inside)
    for kernel in kernels:
        kernel.compile(arguments[kernel])


def help_out(kernels: tuple[Any, ...]) -> None:
    """Compile these into the cache, as a helper; it ends with the process that has started it."""
    threading.Thread(target=_end_with_input, daemon=True).start()
    os.nice(NICENESS)
    compile_ahead(load_profile("imu"), kernels)


def _end_with_input() -> None:
    """End when nobody holds the other end of standard input any more."""
    sys.stdin.buffer.read()
    os._exit(1)


def rehearse(estimator: Estimator, *, aided: bool) -> None:
    """Run a few samples and velocities, which compiles what is still missing."""
    for number in range(3):
        estimator.update(_sample(number))
        estimator.update_velocity(_report(number))  # heard at the next sample
    estimator.attitude(3 * STEP_US)
    usual_vehicles.rehearse(estimator)
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
        field_lag_s=0.0,
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
def helpers(profile: Profile) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A process for each half that the cache lacks, which compiles it; none is left at the end."""
    if not is_compiled(profile):
        _leave_out_scipy()
    with ExitStack() as stack:
        missing = [half for half, kernels in _halves(profile).items() if _lacks(kernels)]
        yield [stack.enter_context(_helper(half)) for half in missing]


@contextmanager
def _helper(half: str) -> Iterator[subprocess.Popen[bytes]]:
    helper = subprocess.Popen(  # noqa: S603 - our own arguments
        [sys.executable, "-P", "-c", HELPER.format(half=half), str(OUR_FOLDER)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield helper
    finally:
        helper.kill()
        helper.communicate()


def await_end(helper: subprocess.Popen[bytes]) -> None:
    """Wait for a helper's end; what it has not compiled the service does itself, then."""
    end_s = time.monotonic() + HELPER_S
    while time.monotonic() < end_s and not is_stopped(helper.pid):
        with suppress(subprocess.TimeoutExpired):
            helper.wait(LOOK_S)
            return
