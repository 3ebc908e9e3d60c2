"""The checkpoint of an interrupted search, or of several that follow each other.

A checkpoint is one line of JSON, then the recorded costs as little-endian
doubles, one search behind the other.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from drivers.output_file import written_whole
from estimator.errors import InputError
from tuning.search import Record

SCHEMA = 2


class Header(msgspec.Struct):
    """A checkpoint's first line.

    Of each search the number of costs, and a SHA-256 of all candidates that were asked for.
    """

    schema: int
    identity: Mapping[str, Any]
    evaluations: tuple[int, ...]
    asked_sha256: tuple[str, ...]


def write_atomically(path: Path, content: bytes) -> None:
    """Write all of a file: a reader sees the old content or the new one.

    Raises:
        InputError: the folder or the file cannot be written, or is somebody else's link.
    """
    try:
        with written_whole(path) as fresh:
            fresh.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def checkpoint_path(output: Path) -> Path:
    """FILE.checkpoint."""
    return Path(f"{output}.checkpoint")


def write_checkpoint(path: Path, identity: Mapping[str, Any], records: Sequence[Record]) -> None:
    """Save the records of the searches that ``identity`` (plain JSON values) determines.

    Raises:
        InputError: the file cannot be written.
    """
    counts = tuple(len(record.costs) for record in records)
    header = Header(SCHEMA, identity, counts, tuple(record.asked_sha256 for record in records))
    content = [msgspec.json.encode(header, order="sorted"), b"\n"]
    content += [record.costs.astype("<f8").tobytes() for record in records]
    write_atomically(path, b"".join(content))


def read_checkpoint(path: Path, identity: Mapping[str, Any]) -> list[Record]:
    """The records of the searches that ``identity`` determines, as far as they came.

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
    counts, asked = header.evaluations, header.asked_sha256
    is_whole = 0 < len(counts) == len(asked) and min(counts) >= 0
    if header.schema != SCHEMA or not is_whole or len(costs) != 8 * sum(counts):
        raise InputError(f"{path}: damaged, or of another version")
    plain = msgspec.json.decode(msgspec.json.encode(identity))
    different = _differences(plain, header.identity)
    if different:
        raise InputError(f"--resume: {path} is of other options: {', '.join(different)}")
    ends = np.cumsum(counts)[:-1]
    parts = np.split(np.frombuffer(costs, "<f8"), ends)
    return [Record(part, digest) for part, digest in zip(parts, asked, strict=True)]


def _differences(wanted: Any, saved: Any, name: str = "") -> list[str]:
    """Dotted names of what is not equal."""
    if not isinstance(wanted, dict) or not isinstance(saved, dict):
        return [] if wanted == saved else [name]
    keys = sorted({*wanted, *saved})
    dotted = [f"{name}.{key}" if name else key for key in keys]
    return [
        difference
        for key, inner in zip(keys, dotted, strict=True)
        for difference in _differences(wanted.get(key), saved.get(key), inner)
    ]
