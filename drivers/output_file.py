"""Files that a person names to be written."""

import os
import stat
from pathlib import Path

from estimator.errors import InputError


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
        return path  # it is not there; whoever opens it says what else is wrong
    if not stat.S_ISLNK(about.st_mode):
        return path
    if hasattr(os, "geteuid") and about.st_uid not in (0, os.geteuid()):
        raise InputError(f"{path}: is somebody else's symbolic link: not written to")
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # links in a circle
        raise InputError(f"{path}: cannot be written: {error}") from None
