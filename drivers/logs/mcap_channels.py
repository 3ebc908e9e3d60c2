"""An MCAP file by itself as a reader of ``rosbags``: that one wants the profile of a ROS 2 bag.

Whatever writes MCAP may have messages of ROS in it, in ROS 2's encoding (cdr), ROS 1's or JSON.
"""

import json
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from drivers.logs.bag_bounds import bound_mcap

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
        from mcap.reader import SeekingReader

        bound_mcap()
        self._file = self.path.open("rb")
        try:
            self._kind: Any = SeekingReader
            # to sort a file without an index would take all of it into memory
            self._is_sorted = True
            self._look()
        except BaseException:
            self.close()
            raise

    def _look(self) -> None:
        with suppress(Exception):  # a file that its writer did not finish has no summary
            summary = self._kind(self._file).get_summary()
            counts = summary.statistics.channel_message_counts
            for key, channel in summary.channels.items():
                self._add(channel, summary.schemas.get(channel.schema_id), counts.get(key, 0))
            return
        from mcap.reader import NonSeekingReader

        self._kind, self._is_sorted = NonSeekingReader, False
        seen: dict[int, tuple[Any, Any, int]] = {}
        try:
            for schema, channel, _ in self._messages():
                seen[channel.id] = (channel, schema, seen.get(channel.id, (0, 0, 0))[2] + 1)
        except Exception:  # it may end within a message
            if not seen:
                raise
        self.connections = []
        for channel, schema, count in seen.values():
            self._add(channel, schema, count)

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
        self._file.seek(0)
        found: Iterator[Any] = self._kind(self._file).iter_messages(log_time_order=self._is_sorted)
        return found

    def _add(self, channel: Any, schema: Any, count: int) -> None:
        encoding, title = channel.message_encoding, "" if schema is None else schema.name
        package, _, name = title.rpartition("/")
        kind = f"{package.removesuffix('/msg')}/msg/{name}" if package else title
        if schema is None or encoding not in ENCODINGS:
            kind += f", {encoding}"  # which no decoder is for
        self.connections.append(Channel(channel.id, channel.topic, kind, count, encoding))
