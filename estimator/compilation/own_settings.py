"""Keeps libraries from reading settings in the current folder, which may hold untrusted downloads.

numba reads ``.numba_config.yaml`` there, matplotlib a ``matplotlibrc``. The package imports this
module before anything else; it loads next to nothing itself.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec, PathFinder
from typing import Any

GUARDED = ("numba.core.config", "matplotlib")


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Work in the root folder, where only root can put anything."""
    try:
        # the handle of a folder that may not be listed is enough to come back
        here = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))
    except OSError:  # a folder that was removed: nothing is found there
        yield
        return
    try:
        os.chdir("/")
        yield
    finally:
        with suppress(OSError):
            os.fchdir(here)
        os.close(here)


class _Finder:
    """Has the modules above executed elsewhere."""

    @staticmethod
    def find_spec(name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """See :mod:`importlib`."""
        spec = PathFinder.find_spec(name, path, target) if name in GUARDED else None
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_elsewhere(module: Any) -> None:
            with _elsewhere():
                execute(module)
            if hasattr(module, "_config_fname"):  # numba looks again at each compilation
                module._config_fname = os.devnull  # noqa: SLF001 - no other way

        spec.loader.exec_module = execute_elsewhere  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Finder)
