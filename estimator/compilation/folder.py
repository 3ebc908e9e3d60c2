"""Where compiled kernels are kept: a folder that nobody else can write to.

Beside it a wheel may bring kernels compiled for any CPU of an architecture.

What lies there is run as it is, so a folder is only used if nobody but its owner and root could
have put it there. Its name tells Python, the libraries and the switches that kernels were
compiled with; each kernel's own name tells what it is made of.
"""

import hashlib
import os
import platform
import re
import stat
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

FOLDERS_KEPT = 4  # for whoever switches between versions of Python or numba
PREFIX = "kernels-"
OURS = re.compile(r"kernels-[0-9a-f]{16}")
# A kernel's file: its name, a digest of what it is made of, Python's version; data files a number.
KERNEL = re.compile(r"[\w.]+-[0-9a-f]{16}\.py3\d+t?\.(?:nbi|\d+\.nbc)")
UNFINISHED = re.compile(rf"{KERNEL.pattern}\.tmp\.[0-9a-f]{{16}}")  # of a process that was killed
# numba's switches that change no machine code
OTHER_SWITCHES = re.compile(
    r"NUMBA_(CACHE_DIR|CACHE_LOCATOR_CLASSES|NUM_THREADS|THREADING_LAYER\w*|DEBUG_CACHE|WARNINGS"
    r"|COLOR_SCHEME|DUMP_\w+|TRACE|HIGHLIGHT_DUMPS|DISABLE_PERFORMANCE_WARNINGS)"
)
# Settings that change machine code; their values count, wherever they were set
SETTINGS = (
    "OPT",
    "CPU_NAME",
    "CPU_FEATURES",
    "ENABLE_AVX",
    "DISABLE_INTEL_SVML",
    "LOOP_VECTORIZE",
    "SLP_VECTORIZE",
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
)
# Those of them that say for which CPU
OF_CPU = ("CPU_NAME", "CPU_FEATURES", "ENABLE_AVX", "DISABLE_INTEL_SVML")
# What a wheel brings lies here, in a folder for each kind of Python and architecture.
SHIPPED = Path(__file__).parents[1] / "kernels"


def kernel_folders(options: str) -> tuple[Path, ...]:
    """Folders for kernels compiled with these ``options``, to be looked through in turn.

    ``NUMBA_CACHE_DIR``, or beside the sources where that is not set, then the user's cache
    folder: up to the first that can be written to, which takes what is compiled. The others
    are read, as those of a container's image or of root. Warns of a chosen folder that others
    can write to.
    """
    name = PREFIX + environment_digest(options)
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    found: list[Path] = []
    for base in _bases(chosen):
        folder = _open_folder(base, name)
        if folder is None:
            continue
        fault = mistrust(folder)
        if fault is None:
            found.append(folder)
            if os.access(folder, os.W_OK | os.X_OK):
                forget_older(folder.parent, name)
                break
        elif chosen is not None and base == Path(chosen):
            text = f"NUMBA_CACHE_DIR={chosen} is not used: {fault}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
    return tuple(found)


def environment_digest(options: str) -> str:
    """Digest of what changes machine code beside sources and CPU (numba checks that itself)."""
    import llvmlite
    import numba
    import numpy as np

    config: Any = numba.config
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)
    settings = [f"{name}={getattr(config, name, None)}" for name in SETTINGS]
    switches = sorted(
        f"{name}={value}"
        for name, value in os.environ.items()
        if name.startswith("NUMBA_") and value and not OTHER_SWITCHES.fullmatch(name)
    )
    parts = (*versions, options, *settings, *switches)
    return _digest(parts)


def shipped_folder(options: str) -> Path | None:
    """The folder of kernels that came with the wheel, if they fit this Python and these libraries.

    Nobody but the package's owner and root may be able to write to it.
    """
    folder = _open_folder(SHIPPED, PREFIX + shipped_digest(options), makes=False)
    return None if folder is None or mistrust(folder) is not None else folder


def shipped_digest(options: str) -> str:
    """Digest of what makes code for any CPU fit: as :func:`environment_digest`, less narrowly.

    A patch release of Python or numpy changes nothing that compiled code knows of.
    """
    import llvmlite
    import numba
    import numpy as np

    config: Any = numba.config
    versions = (numba.__version__, llvmlite.__version__, np.__version__.partition(".")[0])
    settings = [f"{name}={getattr(config, name, None)}" for name in SETTINGS if name not in OF_CPU]
    python = (sys.implementation.cache_tag, sys.platform, platform.machine())
    return _digest((*versions, *python, options, *settings))


def _digest(parts: tuple[str, ...]) -> str:
    return hashlib.sha256("\n".join(parts).encode("utf-8", "replace")).hexdigest()[:16]


def _bases(chosen: str | None) -> list[Path]:
    first = Path(__file__).parents[1] / "__pycache__" if chosen is None else Path(chosen)
    home_cache = os.environ.get("XDG_CACHE_HOME", "")
    if not Path(home_cache).is_absolute():  # nothing of the current folder's counts
        try:
            home_cache = str(Path("~/.cache").expanduser())
        except RuntimeError:  # a user without a home
            return [first]
    return [first, Path(home_cache) / "fuzzbee"]


def _open_folder(base: Path, name: str, *, makes: bool = True) -> Path | None:
    """The folder by its real name, made if need be; None if it can neither be made nor read."""
    try:
        if makes:
            base.mkdir(mode=0o755, parents=True, exist_ok=True)
        folder = base.resolve() / name
        if makes:
            folder.mkdir(mode=0o755, exist_ok=True)
    except OSError:
        folder = base / name
    try:
        return folder.resolve() if os.access(folder, os.R_OK | os.X_OK) else None
    except OSError:
        return None


def mistrust(folder: Path) -> str | None:
    """Why others may have put there what lies in a folder, in a few words; None if they cannot.

    ``folder`` is a real path, without symbolic links. Everything from the root on counts:
    whoever can rename a parent can put another folder in its place. In a folder like /tmp, with
    the sticky bit, only its own owner can do that to a folder.
    """
    if not hasattr(os, "getuid"):
        return None
    for part in (*reversed(folder.parents), folder):
        try:
            about = part.stat(follow_symlinks=False)
        except OSError as error:
            return f"{part}: {error.strerror}"
        if not stat.S_ISDIR(about.st_mode):
            return f"{part} is not a folder"
        fault = _open_to_others(part, about, sticky_is_fine=part != folder)
        if fault is not None:
            return fault
    try:
        inside = [(entry.name, entry.stat(follow_symlinks=False)) for entry in os.scandir(folder)]
    except OSError as error:
        return f"{folder}: {error.strerror}"
    faults = (_open_to_others(folder / each, about) for each, about in inside)
    return next((fault for fault in faults if fault is not None), None)


def _open_to_others(
    path: Path, about: os.stat_result, *, sticky_is_fine: bool = False
) -> str | None:
    if about.st_uid not in (0, os.geteuid()):
        return f"{path} belongs to somebody else"
    others = stat.S_IWOTH
    if about.st_mode & stat.S_IWGRP and not _is_private_group(about.st_gid):
        others |= stat.S_IWGRP
    is_sticky = bool(about.st_mode & stat.S_ISVTX) and sticky_is_fine
    if about.st_mode & others and not is_sticky and not stat.S_ISLNK(about.st_mode):
        return f"others may write to {path}"
    return None


def _is_private_group(gid: int) -> bool:
    """Whether only we are in that group: many systems give each user one of the same name."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(gid), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    is_own = group.gr_name == user.pw_name and user.pw_gid == gid
    return is_own and set(group.gr_mem) <= {user.pw_name}


def forget_older(base: Path, name: str) -> None:
    """Remove all but the latest few of our folders; in them only the files that we wrote.

    It is no error if another process does so at the same time.
    """
    try:
        others = [path for path in base.iterdir() if path.name != name and _is_ours(path)]
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    except OSError:
        return
    for folder in others[FOLDERS_KEPT - 1 :]:
        forget_kernels(folder)
        with suppress(OSError):  # somebody else's file is in it: it stays
            folder.rmdir()


def _is_ours(path: Path) -> bool:
    if not OURS.fullmatch(path.name) or path.is_symlink() or not path.is_dir():
        return False
    return not hasattr(os, "getuid") or path.stat().st_uid == os.geteuid()


def forget_kernels(folder: Path) -> None:
    """Remove the files of kernels in a folder, and nothing else."""
    with suppress(OSError):
        for path in list(folder.iterdir()):
            is_kernel = KERNEL.fullmatch(path.name) or UNFINISHED.fullmatch(path.name)
            if is_kernel and not path.is_dir():
                with suppress(OSError):
                    path.unlink()
