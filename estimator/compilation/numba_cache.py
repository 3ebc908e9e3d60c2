"""numba's own cache, for a numba without the private classes that :mod:`kernel_cache` builds on.

It compiles a kernel anew when the kernel's own file changes, but not after a change in another
one. So each state of the estimator's sources has a folder of its own.
"""

import functools
import hashlib
import warnings
from pathlib import Path
from typing import Any

import numba

OTHER_NUMBA = (
    "this version of numba keeps compiled code another way: it is kept by numba's own cache, "
    "and compiled anew after any change of the sources"
)

_numba_config: Any = numba.config  # numba ships no types


def keep_by_numba(dispatcher: Any, folder: Path) -> None:
    """Have numba itself keep a kernel's code below ``folder``; the first time, warn of it."""
    before = _numba_config.CACHE_DIR
    _numba_config.CACHE_DIR = _folder_of_sources(folder)
    try:
        dispatcher.enable_caching()
    finally:
        _numba_config.CACHE_DIR = before


@functools.cache
def _folder_of_sources(folder: Path) -> str:
    """The folder of the estimator's sources as they are."""
    warnings.warn(OTHER_NUMBA, RuntimeWarning, stacklevel=2)
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    return str(folder / digest.hexdigest()[:16])
