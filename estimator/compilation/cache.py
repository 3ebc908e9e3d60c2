"""Where compiled kernels are kept: a folder that names the sources they came from.

numba renews a cached function when its own file changes, not when a file that
it calls or takes its types from does, so an upgrade could run new code on old
layouts. The folder's name is a digest of all sources, numba and Python, so
what lies in it fits, or is not found.

numba must be able to write where it reads. Kernels that came with a read-only
file system (a container's image) are therefore copied to a temporary folder.
"""

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

PACKAGES = ("estimator", "tuning")  # the ones that hold kernels
FOLDERS_KEPT = 4  # older versions', for whoever switches between them
FOLDER_PREFIX = "kernels-"
# Containers with a read-only file system have it even when they have no /tmp.
SHARED_MEMORY = "/dev/shm"  # noqa: S108 - a folder of our own is made in it


def kernel_cache_folder() -> Path | None:
    """A writable folder for this version's kernels, or None where there is none.

    Tried in turn: ``NUMBA_CACHE_DIR``, beside the sources, the user's cache folder. Of kernels
    that are there but cannot be written, a temporary copy.
    """
    name = FOLDER_PREFIX + _digest()
    for base in _bases():
        folder = base / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            _forget_older(base, name)
            return folder
        copy = _writable_copy(folder)
        if copy is not None:
            return copy
    return None


def _bases() -> list[Path]:
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return [Path(chosen)]
    home_cache = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return [Path(__file__).parent.parent / "__pycache__", Path(home_cache) / "fuzzbee"]


def _digest() -> str:
    import numba

    root = Path(__file__).parents[2]
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for package in PACKAGES:
        for source in sorted((root / package).rglob("*.py")):
            digest.update(source.relative_to(root).as_posix().encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _writable_copy(folder: Path) -> Path | None:
    """The kernels of a folder that cannot be written, in one that ends with this process."""
    try:
        kernels = [path for path in folder.rglob("*.nb[ci]") if path.is_file()]
    except OSError:
        return None
    if not kernels:
        return None
    for parent in (None, SHARED_MEMORY):
        try:
            copy = Path(tempfile.mkdtemp(prefix="fuzzbee-", dir=parent))
        except OSError:
            continue
        atexit.register(shutil.rmtree, copy, ignore_errors=True)
        try:
            for kernel in kernels:
                target = copy / kernel.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(kernel, target)
        except OSError:
            continue  # too small
        return copy
    return None


def _forget_older(base: Path, name: str) -> None:
    """Remove all but the latest few folders; another process may do so at the same time."""
    try:
        others = [path for path in base.glob(f"{FOLDER_PREFIX}*") if path.name != name]
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    except OSError:
        return
    for path in others[FOLDERS_KEPT - 1 :]:
        shutil.rmtree(path, ignore_errors=True)
