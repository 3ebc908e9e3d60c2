"""The checkpoint of an interrupted search: a line of JSON, the costs as little-endian doubles."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drivers.output_file import written_for
from estimator.errors import InputError
from tuning.search import Record

SCHEMA = 3


class Header(msgspec.Struct):
    """A checkpoint's first line; the SHA-256 is of all candidates that were asked for."""

    schema: int
    identity: Mapping[str, Any]
    evaluations: int
    asked_sha256: str


def checkpoint_path(output: Path) -> Path:
    """FILE.checkpoint."""
    return Path(f"{output}.checkpoint")


def write_checkpoint(path: Path, identity: Mapping[str, Any], record: Record) -> None:
    """Save the record of the search that ``identity`` (plain JSON values) determines.

    Raises:
        InputError: the file cannot be written.
        NotWholeError: the disk is full, or fails.
    """
    header = Header(SCHEMA, identity, len(record.costs), record.asked_sha256)
    line = msgspec.json.encode(header, order="sorted")
    with written_for("--output", path) as fresh:
        fresh.write_bytes(line + b"\n" + record.costs.astype("<f8").tobytes())


def read_checkpoint(path: Path, identity: Mapping[str, Any]) -> Record:
    """The record of the search that ``identity`` determines, as far as it came.

    Raises:
        InputError: no such file, not a checkpoint, or one of another search.
    """
    try:
        # nor is a pipe waited for
        content = path.read_bytes() if path.is_file() or not path.exists() else b""
    except FileNotFoundError:
        raise InputError(f"--resume: {path}: no such file; nothing to resume") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    line, _, costs = content.partition(b"\n")
    try:
        header = msgspec.json.decode(line, type=Header)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not a checkpoint") from None
    if header.schema != SCHEMA or len(costs) != 8 * header.evaluations:
        raise InputError(f"{path}: damaged, or of another version")
    plain = msgspec.json.decode(msgspec.json.encode(identity))
    different = _differences(plain, header.identity)
    if different:
        raise InputError(f"--resume: {path} is of other options: {', '.join(different)}")
    return Record(np.frombuffer(costs, "<f8"), header.asked_sha256)


def _differences(wanted: Any, saved: Any, name: str = "") -> list[str]:
    """Dotted names of what is not equal."""
    if wanted == saved:
        return []
    if not isinstance(wanted, dict) or not isinstance(saved, dict):
        return [name]
    return [
        difference
        for key in sorted({*wanted, *saved})
        for difference in _differences(
            wanted.get(key), saved.get(key), f"{name}.{key}" if name else key
        )
    ]
