"""Compiles every kernel that a command calls: a step of setting up, of a wheel and of an image.

python -m fuzzbee.kernels
"""

import importlib
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from rich.console import Console
from rich.progress import track

from estimator.compilation.compiled import called_kernels, entry_point
from estimator.compilation.kernel_folder import NO_FOLDER, KernelLocator

MODULES = (  # with kernels that commands call; those that take longest come first
    "estimator.live.kernel_handle",
    "estimator.estimator",
    "estimator.geometry.metrics",
    "drivers.samples.imu_stream",
    "tuning.paper_cost",
    "tuning.prediction",
    "tuning.turning",
)
LONGEST = ("advance", "take_report")


def build_one(module: str, name: str) -> None:
    """Compile one kernel, or find it where kernels are kept."""
    entry_point(getattr(importlib.import_module(module), name))


def main() -> int:
    """Compile what is missing, several kernels at once; one line of progress."""
    console = Console(stderr=True, soft_wrap=True)
    path, begin_s = KernelLocator.folder.path, time.monotonic()
    if path is None:
        console.print(f"fuzzbee: {NO_FOLDER}")
        return 1
    for module in MODULES:
        importlib.import_module(module)
    functions = [kernel.py_func for kernel in called_kernels()]  # whose types are known
    functions.sort(key=lambda each: each.__name__ not in LONGEST)
    with ProcessPoolExecutor(os.cpu_count() or 1, get_context("spawn")) as pool:
        jobs = [pool.submit(build_one, each.__module__, each.__name__) for each in functions]
        bar: Any = {"console": console, "transient": True}
        for job in track(as_completed(jobs), "compiling the filter", len(jobs), **bar):
            job.result()
    console.print(f"the filter is compiled, {time.monotonic() - begin_s:.0f} s: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
