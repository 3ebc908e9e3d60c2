"""Compiles the service's kernels for any CPU, into the folder that a wheel brings.

``make kernels`` runs it, with ``NUMBA_CPU_NAME=generic``. Kernels for another version of Python,
made by another run, stay.
"""

import shutil
import sys
from pathlib import Path

from estimator.compilation.compiled import OPTIONS
from estimator.compilation.folder import KERNEL, PREFIX, SHIPPED, shipped_digest
from estimator.live import resident
from estimator.profile import load_profile
from service.warm_up import FOR_VELOCITY, UNAIDED, compile_ahead, warm_up


def ship() -> Path:
    """Compile all that the service calls, and copy it; returns the folder."""
    profile = load_profile("imu")
    warm_up(profile, None)
    compile_ahead(profile, (*UNAIDED, *FOR_VELOCITY))
    made = Path(resident.advance._cache.cache_path)  # type: ignore[attr-defined] # noqa: SLF001
    folder = SHIPPED / (PREFIX + shipped_digest(OPTIONS))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for path in made.iterdir():
        if KERNEL.fullmatch(path.name):
            shutil.copyfile(path, folder / path.name)
    return folder


if __name__ == "__main__":
    print(ship(), file=sys.stderr)
