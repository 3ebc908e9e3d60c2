"""Compiles every kernel that a command calls: a step of setting up, of a wheel and of an image.

python -m fuzzbee.kernels
"""

import importlib
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from estimator.compilation.compiled import called_kernels, entry_point
from estimator.compilation.kernel_folder import NO_FOLDER, KernelLocator

# What has kernels that commands call; those that take longest come first
MODULES = (
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
    columns = (TextColumn("compiling the filter"), BarColumn(), TimeElapsedColumn())
    with (
        ProcessPoolExecutor(os.cpu_count() or 1, get_context("spawn")) as pool,
        Progress(*columns, console=console, transient=True) as bar,
    ):
        for module in MODULES:
            importlib.import_module(module)
        functions = [kernel.py_func for kernel in called_kernels()]  # whose types are known
        names = [(function.__module__, function.__name__) for function in functions]
        names.sort(key=lambda each: each[1] not in LONGEST)
        jobs = [pool.submit(build_one, *each) for each in names]
        for job in bar.track(as_completed(jobs), len(jobs)):
            job.result()
    console.print(f"the filter is compiled, {time.monotonic() - begin_s:.0f} s: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
