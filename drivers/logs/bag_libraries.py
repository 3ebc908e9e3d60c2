"""What the libraries that read bags lack: bounds, and MCAP files by themselves.

A few bytes can be the beginning of gigabytes: packed ones, a file with a hole, a column of a
database that is worked out when it is read. ``rosbags`` reads MCAP only in the profile of a ROS 2
bag, but whatever writes MCAP may have messages of ROS in it, in ROS 2's encoding (cdr), ROS 1's or
JSON.
"""

import io
import json
import shutil
import tempfile
from bz2 import BZ2Decompressor
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

# Writers begin a new chunk after a few MB; one image may be more.
LARGEST = 1 << 26  # bytes of a chunk or a message
TOO_LARGE = f"a chunk or message of more than {LARGEST >> 20} MB"
WORKED_OUT = "SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden > 1"

ENCODINGS = ("cdr", "ros1", "json")
NANOSECONDS = ("nanosec", "nsec", "nsecs")  # ROS 2's name and those of others
EMPTY = SimpleNamespace()
DEFAULTS = {
    "header": EMPTY,
    "orientation": SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0),
    "orientation_covariance": [0.0],
    "status": SimpleNamespace(status=0),
    "altitude": 0.0,
}


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
    """The packed bytes, whatever size they claim.

    Raises:
        ValueError: it is larger than :data:`LARGEST`.
    """
    from lz4.frame import LZ4FrameDecompressor
    from zstandard import ZstdDecompressor

    if compression == "zstd":
        whole: bytes = ZstdDecompressor().stream_reader(data).read(LARGEST + 1)
    else:
        kind = LZ4FrameDecompressor if compression == "lz4" else BZ2Decompressor
        whole = kind().decompress(data, max_length=LARGEST + 1)
    if len(whole) > LARGEST:
        raise ValueError(TOO_LARGE)
    return whole


@cache
def bound_libraries() -> None:
    """Bound what ``mcap`` and ``rosbags`` unpack, and what a bag's databases give."""
    import apsw
    from mcap import stream_reader
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader, storage_mcap

    mcap: Any = stream_reader
    two: Any = reader
    unpack = mcap.get_chunk_data_stream

    def unpack_bounded(chunk: Any, validate_crc: bool = False) -> Any:
        if chunk.compression in ("zstd", "lz4"):
            chunk = replace(chunk, compression="", data=unpacked(chunk.compression, chunk.data))
        return unpack(chunk, validate_crc)

    mcap.get_chunk_data_stream = unpack_bounded
    ros1.decompressors.update({name: partial(unpacked, name) for name in ("bz2", "lz4")})
    storage_mcap.DECOMPRESSORS.update({name: partial(unpacked, name) for name in ("zstd", "lz4")})

    class Unpacking(two.zstd.ZstdFile):  # type: ignore[misc]
        """Unpacked whole into the folder for temporary ones: others need room there."""

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


def from_json(data: bytes, _kind: str) -> Any:
    """A message that was written as JSON; what it may leave out has its value for "unknown".

    Raises:
        TypeError, ValueError: it is no message.
    """
    read = json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
    message = SimpleNamespace(**{**DEFAULTS, **vars(read)})
    stamp = vars(vars(message.header).get("stamp", EMPTY))
    seconds = int(stamp.get("sec", stamp.get("secs", 0)))
    nanoseconds = int(next((stamp[name] for name in NANOSECONDS if name in stamp), 0))
    message.header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))
    return message


class Channel(NamedTuple):
    """A channel, with the names that ``rosbags`` has for its parts."""

    id: int
    topic: str
    msgtype: str
    msgcount: int
    encoding: str


class McapChannels:
    """The channels of a file, and their messages in the order of recording if it has an index."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Channel] = []

    def open(self) -> None:
        """Look what there is; a file without an index is read through for it."""
        self._file = self.path.open("rb")
        try:
            self.connections = [_channel(*each) for each in self._look()]
        except BaseException:
            self.close()
            raise

    def _look(self) -> list[tuple[Any, Any, int]]:
        """The channels with their schemas and how many messages they have."""
        from mcap.reader import SeekingReader

        self._has_index = True
        with suppress(Exception):  # a file that its writer did not finish has no summary
            summary: Any = SeekingReader(self._file).get_summary()
            counts, schemas = summary.statistics.channel_message_counts, summary.schemas
            channels = summary.channels.items()
            return [(c, schemas.get(c.schema_id), counts.get(key, 0)) for key, c in channels]
        self._has_index = False
        seen: dict[int, tuple[Any, Any, int]] = {}
        try:
            for schema, channel, _ in self._messages():
                seen[channel.id] = (channel, schema, seen.get(channel.id, (0, 0, 0))[2] + 1)
        except Exception:  # it may end within a message
            if not seen:
                raise
        return [*seen.values()]

    def messages(self, wanted: Collection[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """(channel, time of recording in ns, data) of the wanted channels."""
        by_id = {channel.id: channel for channel in wanted}
        for _, channel, message in self._messages():
            if channel.id in by_id:
                yield by_id[channel.id], message.log_time, message.data

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _messages(self) -> Iterator[Any]:
        from mcap.reader import NonSeekingReader, SeekingReader

        self._file.seek(0)
        kind: Any = SeekingReader if self._has_index else NonSeekingReader
        # to sort a file without an index would take all of it into memory
        yield from kind(self._file).iter_messages(log_time_order=self._has_index)


def _channel(channel: Any, schema: Any, count: int) -> Channel:
    encoding, title = channel.message_encoding, "" if schema is None else schema.name
    package, _, name = title.rpartition("/")
    kind = f"{package.removesuffix('/msg')}/msg/{name}" if package else title
    if schema is None or encoding not in ENCODINGS:
        kind += f", {encoding}"  # which no decoder is for
    return Channel(channel.id, channel.topic, kind, count, encoding)
