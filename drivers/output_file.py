"""Files that a person names to be written."""

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from io import FileIO
from pathlib import Path

from estimator.errors import InputError

# Errors of the disk, not of the name that the user gave.
DISK_ERRORS = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO})


class NotWholeError(Exception):
    """A file could not be written to its end, though its name was good."""


def output_path(path: Path) -> Path:
    """Where to write: a symbolic link is followed, if it is not somebody else's.

    In a shared folder anybody can leave a link under a name that is likely to be written to,
    which leads to a file of ours.

    Raises:
        InputError: it is.
    """
    try:
        about = path.lstat()
    except (OSError, ValueError):
        return path  # it is not there; opening it reports any other error
    if not stat.S_ISLNK(about.st_mode):
        return path
    if hasattr(os, "geteuid") and about.st_uid not in (0, os.geteuid()):
        raise InputError(f"{path}: is somebody else's symbolic link: not written to")
    try:
        # /dev/stdout leads to a pipe, which has no path of its own
        return path.resolve() if path.is_file() or not path.exists() else path
    except (OSError, RuntimeError) as error:  # links in a circle
        raise InputError(f"{path}: cannot be written: {error}") from None


def _held_open(path: Path) -> AbstractContextManager[object]:
    """A pipe open meanwhile, or its reader would see an end; nothing of what is no pipe.

    Raises:
        InputError: a pipe that nobody reads: to open it would wait for ever.
    """
    if not path.is_fifo():
        return nullcontext()
    try:
        return FileIO(os.open(path, os.O_WRONLY | os.O_NONBLOCK), "wb")
    except OSError as error:
        if error.errno != errno.ENXIO:
            raise
        raise InputError(f"{path}: a pipe that nobody reads, start its reader first") from None


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A file to be written beside ``path``, which takes its place once it is whole.

    Whatever ends the writing, an error, an interrupt or the power: nobody finds half a file, and
    what was there before stays. What is no regular file, as a pipe, is written to itself, and so is
    a file in a folder that takes no others.

    Raises:
        InputError: see :func:`output_path`; or it is a pipe that nobody reads.
        OSError: it cannot be written.
    """
    path = output_path(path)
    is_there = os.path.lexists(path)
    if is_there and not (path.is_file() and os.access(path.parent, os.W_OK)):
        with _held_open(path):
            yield path
        return
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".unfinished-", suffix=path.suffix)
    os.close(handle)
    fresh = Path(name)
    try:
        yield fresh
        with fresh.open("rb") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        fresh.chmod(stat.S_IMODE(path.stat().st_mode) if is_there else 0o666 & ~umask)
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise


@contextmanager
def written_for(option: str, path: Path) -> Iterator[Path]:
    """:func:`written_whole` for an option's file.

    Raises:
        InputError: it cannot be written; names the option.
        NotWholeError: the disk is full, or fails.
    """
    try:
        with written_whole(path) as fresh:
            yield fresh
    except OSError as error:
        if error.errno in DISK_ERRORS:
            raise NotWholeError(f"{option} {path}: {error.strerror}, not written") from None
        raise InputError(f"{option} {path}: {error.strerror}") from None
