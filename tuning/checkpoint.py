"""Files that are whole or not there, and the checkpoint of an interrupted search.

A checkpoint is one line of JSON, then the recorded costs as little-endian
doubles.
"""

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estimator.errors import InputError
from tuning.search import Record

SCHEMA = 1


def write_atomically(path: Path, content: bytes) -> None:
    """Write a neighbour and rename it: a reader sees the old file or the new one.

    Raises:
        InputError: the folder or the file cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(name).chmod(0o666 & ~umask)  # mkstemp's files are private
        Path(name).replace(path)
    except OSError as error:
        Path(name).unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def checkpoint_path(output: Path) -> Path:
    """FILE.checkpoint."""
    return output.with_name(output.name + ".checkpoint")


def write_checkpoint(path: Path, identity: Mapping[str, Any], record: Record) -> None:
    """Save the record of the search that ``identity`` (plain JSON values) determines.

    Raises:
        InputError: the file cannot be written.
    """
    header = {
        "schema": SCHEMA,
        "identity": identity,
        "evaluations": len(record.costs),
        "asked_sha256": record.asked_sha256,
    }
    content = json.dumps(header, sort_keys=True).encode() + b"\n"
    write_atomically(path, content + record.costs.astype("<f8").tobytes())


def read_checkpoint(path: Path, identity: Mapping[str, Any]) -> Record:
    """The record of the search that ``identity`` determines.

    Raises:
        InputError: no such file, not a checkpoint, or one of another search.
    """
    try:
        line, _, costs = path.read_bytes().partition(b"\n")
        header = json.loads(line)
        record = Record(np.frombuffer(costs, "<f8"), header["asked_sha256"])
        if header["schema"] != SCHEMA or len(record.costs) != header["evaluations"]:
            raise InputError(f"{path}: damaged, or of another version")
        saved = header["identity"]
    except FileNotFoundError:
        raise InputError(f"--resume: {path}: no such file; nothing to resume") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a checkpoint") from None
    plain = json.loads(json.dumps(identity))
    different = sorted(k for k in {*plain, *saved} if plain.get(k) != saved.get(k))
    if different:
        raise InputError(f"--resume: {path} is of other options: {', '.join(different)} differ")
    return record
