"""Where compiled kernels are kept, and the locator that leads numba's own cache there.

numba's locators miss changes of an inlined function in another file, and need a writable folder.
Here one folder holds the kernels of one state of all sources: a digest of them, of Python, the
libraries and the target CPU names it, so nothing in it is stale. It stands beside the sources and
is as trustworthy as they are; wheels and images contain it. This module loads nothing heavy, so
that a command can ask for the notice of compiling long before it needs numba.
"""

import hashlib
import os
import platform
import shutil
import stat
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Self

SOURCES = Path(__file__).parents[1]
BESIDE = SOURCES / "kernels"
KEPT = 3  # folders of other states of the sources, for switching between branches
COMPILING = "compiling the filter: it takes a minute or so, and goes on then"
NO_FOLDER = (
    "no writable folder for compiled code, neither beside fuzzbee nor ~/.cache/fuzzbee: "
    "compiling in memory at each start"
)

_listeners: list[Callable[[str], None]] = []
_asked: list[Callable[[str], None]] = []


class KernelFolder:
    """The folder in use; ``path`` is None where kernels cannot be kept."""

    def __init__(self, digest: str) -> None:
        self.digest = digest
        self.path: Path | None = None
        self.is_writable = False
        for base in filter(None, (BESIDE, user_cache())):
            path = base / digest
            if base == BESIDE and path.is_dir() and not os.access(path, os.W_OK):
                self.path = path  # of an image, or of root: it is read, and holds everything
                return
            if made(path) and (base == BESIDE or is_private(path)):
                self.path, self.is_writable = path, True
                others = [each for each in base.iterdir() if each != path and each.is_dir()]
                others.sort(key=lambda each: each.stat().st_mtime, reverse=True)
                for older in others[KEPT:]:
                    shutil.rmtree(older, ignore_errors=True)
                return
        warnings.warn(NO_FOLDER, RuntimeWarning, stacklevel=2)


class KernelLocator:
    """Gives numba's cache the folder of one function's kernels."""

    folder: KernelFolder

    def __init__(self, module: str) -> None:
        assert self.folder.path is not None
        self._path = self.folder.path / module

    @classmethod
    def from_function(cls, function: Callable[..., Any], _file: str) -> Self | None:
        """The locator for one of our functions; None for others."""
        module = function.__module__
        is_ours = module.partition(".")[0] in ("estimator", "drivers", "tuning")
        return cls(module) if is_ours and cls.folder.path is not None else None

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._path.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder of the function's module."""
        return str(self._path)

    def get_source_stamp(self) -> str:
        """What changes with the sources: the folder's own name."""
        return self.folder.digest

    def get_disambiguator(self) -> str:
        """One name for all: modules have folders of their own."""
        return "kernel"


@cache
def sources_digest(*settings: str) -> str:
    """Digest of all sources that kernels are made of, of Python, libraries and ``settings``."""
    import llvmlite
    import numba
    import numpy as np

    digest = hashlib.sha256()
    for folder in ("estimator", "drivers/samples", "tuning"):
        root = SOURCES.parent / folder
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode())
            digest.update(file.read_bytes())
    python = (str(sys.implementation.cache_tag), sys.platform, platform.machine())
    versions = (numba.__version__, llvmlite.__version__, np.__version__.partition(".")[0])
    for part in (*python, *versions, *settings):
        digest.update(part.encode())
    return digest.hexdigest()[:16]


def user_cache() -> Path | None:
    """The user's own cache folder; nothing of the current folder's counts."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(given) if Path(given).is_absolute() else Path("~/.cache").expanduser()
    except RuntimeError:  # a user without a home
        return None
    return base / "fuzzbee"


def made(path: Path) -> bool:
    """Whether the folder is there, made if need be, and can be written to."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(path, os.W_OK | os.X_OK)


def is_private(path: Path) -> bool:
    """Whether only the user can write to the folder, whose content is run."""
    if not hasattr(os, "getuid"):
        return True
    for folder in (path, path.parent):
        about = folder.stat(follow_symlinks=False)
        is_open = about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if not stat.S_ISDIR(about.st_mode) or is_open or about.st_uid != os.getuid():
            warnings.warn(f"{folder} is not used: others may write to it", RuntimeWarning, 2)
            return False
    return True


def notify_compiling(notify: Callable[[str], None]) -> None:
    """Call ``notify`` with a line, once, when the first kernel has to be compiled."""
    _listeners[:] = _asked[:] = [notify]


def notify_programs() -> None:
    """Write to standard error, unless the command or a program has asked for the notice."""
    if not _asked:
        notify_compiling(lambda text: print(f"fuzzbee: {text}", file=sys.stderr, flush=True))


def compiling_begins() -> None:
    """Notify that a kernel is not in the cache: a minute of silence looks like a fault."""
    while _listeners:
        _listeners.pop()(COMPILING)
