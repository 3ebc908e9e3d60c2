"""What ``run --workers`` goes together with."""

import os
from typing import TYPE_CHECKING

from estimator.errors import InputError
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say

if TYPE_CHECKING:
    from drivers.endpoint import Endpoint

MOST_WORKERS = 64


def require_workers(workers: int) -> None:
    """Refuse a number that is none of processes; say if there are fewer cores.

    Raises:
        InputError: it is below 1, far too many, or this system cannot fork.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers}: should be 1 to {MOST_WORKERS}")
    if workers > 1 and not hasattr(os, "fork"):
        raise InputError(f"--workers {workers}: needs a system that can fork")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    if workers > 1 and cores is not None and workers > cores:
        say(f"--workers {workers}: more than there are cores ({cores}) only costs memory")


def require_shareable(options: RunOptions, endpoint: "Endpoint") -> None:
    """Refuse what cannot be shared out to workers.

    Raises:
        InputError: names the option.
    """
    if endpoint.kind in ("sim", "log"):
        raise InputError(f"--workers shares out the vehicles of a MAVLink link; {endpoint} is none")
    if options.retune:
        raise InputError("--retune cannot be used with --workers")
