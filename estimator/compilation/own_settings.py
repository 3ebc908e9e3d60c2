"""Keeps libraries from reading settings in the current folder, which may hold untrusted downloads.

numba reads ``.numba_config.yaml`` there, matplotlib a ``matplotlibrc``. The package imports this
module before anything else; it loads next to nothing itself.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec, PathFinder
from typing import Any


@contextmanager
def _without_yaml() -> Iterator[None]:
    """Keep numba from reading a file, now and at each compilation; its warning is dropped."""
    import warnings

    before = {name: sys.modules[name] for name in ("yaml",) if name in sys.modules}
    sys.modules["yaml"] = None  # type: ignore[assignment]  # what Python takes for "not there"
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A Numba config file is found")
            yield
        setattr(sys.modules["numba.core.config"], "_config_fname", os.devnull)  # noqa: B010 - untyped
    finally:
        del sys.modules["yaml"]
        sys.modules.update(before)


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Work in the root folder, where only root can put anything."""
    try:
        here = os.open(".", os.O_RDONLY)
    except OSError:  # a folder that was removed, or may not be read: nothing is found there
        yield
        return
    try:
        os.chdir("/")
        yield
    finally:
        with suppress(OSError):
            os.fchdir(here)
        os.close(here)


GUARDED: dict[str, Callable[[], Any]] = {
    "numba.core.config": _without_yaml,
    "matplotlib": _elsewhere,
}


class _Finder:
    """Has the modules above executed under their guards."""

    @staticmethod
    def find_spec(name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """See :mod:`importlib`."""
        guard = GUARDED.get(name)
        spec = None if guard is None else PathFinder.find_spec(name, path, target)
        if guard is None or spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_guarded(module: Any) -> None:
            with guard():
                execute(module)

        spec.loader.exec_module = execute_guarded  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Finder)
