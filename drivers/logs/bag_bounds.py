"""What the libraries that read bags may take at once: they have no bound of their own.

A few bytes can be the beginning of gigabytes: packed ones, a file with a hole, a column of a
database that is worked out when it is read.
"""

import io
import shutil
import tempfile
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

# Writers begin a new chunk after a few MB; one image may be more.
LARGEST = 1 << 26  # bytes of a chunk or a message
TOO_LARGE = f"a chunk or message of more than {LARGEST >> 20} MB"
WORKED_OUT = "SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden > 1"


class BoundedFile(io.BufferedReader):
    """A file of which no piece larger than that is read, nor a hole, nine bytes at a time.

    Raises:
        ValueError: it is asked for.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._is_no_record = False

    def read(self, size: int | None = -1) -> bytes:
        """See :class:`io.BufferedReader`."""
        if size is None or size < 0:
            size = LARGEST
        elif size > LARGEST:
            raise ValueError(TOO_LARGE)
        data = super().read(size)
        if self._is_no_record and data == bytes(8):  # how MCAP would begin: its kind, its length
            raise ValueError("nothing where a record should begin")
        self._is_no_record = data == b"\0"
        return data

    def readline(self, size: int | None = -1) -> bytes:
        """See :class:`io.BufferedReader`."""
        return super().readline(LARGEST if size is None or size < 0 else size)


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path whose files are bounded, also those of the folder that it is."""

    def open(self, mode: str = "r", *args: Any, **options: Any) -> Any:
        """See :class:`pathlib.Path`."""
        return BoundedFile(self) if mode == "rb" else super().open(mode, *args, **options)


def unpacked(compression: str, data: bytes, _size: int = 0) -> bytes:
    """The packed bytes, by whatever size they say that they have.

    Raises:
        ValueError: it is larger than :data:`LARGEST`.
    """
    if compression == "zstd":
        import zstandard

        whole: bytes = zstandard.ZstdDecompressor().stream_reader(data).read(LARGEST + 1)
    elif compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        whole = LZ4FrameDecompressor().decompress(data, max_length=LARGEST + 1)
    else:
        from bz2 import BZ2Decompressor

        whole = BZ2Decompressor().decompress(data, max_length=LARGEST + 1)
    if len(whole) > LARGEST:
        raise ValueError(TOO_LARGE)
    return whole


@cache
def bound_mcap() -> None:
    """Bound what an MCAP file's chunks are unpacked to."""
    from dataclasses import replace

    from mcap import stream_reader

    unpack: Any = stream_reader.get_chunk_data_stream

    def unpack_bounded(chunk: Any, validate_crc: bool = False) -> Any:
        if chunk.compression in ("zstd", "lz4"):
            chunk = replace(chunk, compression="", data=unpacked(chunk.compression, chunk.data))
        return unpack(chunk, validate_crc)

    stream_reader.get_chunk_data_stream = unpack_bounded


@cache
def bound_bags() -> None:
    """Bound what ``rosbags`` unpacks and what its databases give."""
    import apsw
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader, storage_mcap

    two: Any = reader
    for table, packers in (
        (ros1.decompressors, ("bz2", "lz4")),
        (storage_mcap.DECOMPRESSORS, ("zstd", "lz4")),
    ):
        table.update({name: partial(unpacked, name) for name in packers})
    zstd = two.zstd

    class Unpacking(zstd.ZstdFile):  # type: ignore[misc, name-defined]
        """A whole file that is unpacked into the folder for temporary ones; others need that."""

        def __init__(self, *what: Any) -> None:
            super().__init__(*what)
            self.left = shutil.disk_usage(tempfile.gettempdir()).free // 2

        def read(self, size: int = -1) -> Any:
            data = super().read(size)
            self.left -= len(data)
            if self.left < 0:
                raise ValueError(f"unpacked it would fill {tempfile.gettempdir()}")
            return data

    two.zstd = SimpleNamespace(decompress=partial(unpacked, "zstd"), open=Unpacking)

    def bound(connection: Any) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, LARGEST)
        for table in ("messages", "topics"):
            if connection.execute(WORKED_OUT, (table,)).fetchone()[0]:
                raise ValueError(f"its {table} have columns that are worked out")

    apsw.connection_hooks.append(bound)
