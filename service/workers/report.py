"""What a worker hands back: attitudes and statuses, lines for a person, and counts."""

import pickle
import time
from collections.abc import Callable, Sequence
from struct import Struct

import msgspec

from drivers.events import VehicleId
from service.attitude_rows import AttitudeRows, Made, encoded, expanded
from service.records import AttitudeRecord, Encoded, Message, Output
from service.workers.connection import Connection, Kind
from service.workers.job import Tally

_HEAD = Struct("<BBH")  # system, component, size
TALLY_S = 1.0
_PREFIX = "vehicle "  # of lines that say themselves whom they are about


class Report:
    """A worker's :class:`~service.sinks.outbox.OutputTaker`: all that its loop makes."""

    def __init__(
        self, connection: Connection, name: str, tally: Callable[[], Tally], *, as_records: bool
    ) -> None:
        self.dropped = 0
        self._connection = connection
        self._name = name
        self._tally = tally
        self._as_records = as_records
        self._tally_due_s = 0.0

    def put(self, outputs: Sequence[Made]) -> None:
        """Hand outputs back; never blocks."""
        attitudes: list[bytes] = []
        others: list[Output] = []
        for output in expanded(outputs) if self._as_records else encoded(outputs):
            if isinstance(output, AttitudeRows):
                for vehicle, text in zip(output.vehicles, output.texts, strict=True):
                    attitudes += (_HEAD.pack(*vehicle, len(text)), text)
            elif isinstance(output, Encoded):
                attitudes += (_HEAD.pack(*output.vehicle, len(output.payload)), output.payload)
            elif isinstance(output, Message) and not output.text.startswith(_PREFIX):
                others.append(Message(f"{self._name}: {output.text}"))  # about the worker itself
            else:
                others.append(output)
        if attitudes:
            for dropped in self._connection.put(Kind.ATTITUDES, b"".join(attitudes)):
                self.dropped += len(attitudes_of(dropped))
        if others:
            self._connection.put(Kind.OUTPUTS, pickle.dumps(others))
        if time.monotonic() >= self._tally_due_s:
            self.put_tally()
        if not outputs:
            self._connection.flush()

    def settle(self, timeout_s: float) -> bool:  # noqa: ARG002 - the loop has better to do
        """Whether all is on its way; while it is not, the service has no use for more."""
        return self._connection.flush()

    def put_tally(self) -> None:
        """Hand the counts back, which also says that the worker is alive."""
        self._tally_due_s = time.monotonic() + TALLY_S
        self._connection.put(Kind.COUNTS, pickle.dumps(self._tally()))


def record_of(payload: bytes) -> AttitudeRecord:
    """An attitude as it is published, read back."""
    return msgspec.json.decode(payload, type=AttitudeRecord)


def attitudes_of(body: bytes) -> list[tuple[VehicleId, bytes]]:
    """The attitudes in a message, as they are published."""
    attitudes = []
    at = 0
    while at < len(body):
        system_id, component_id, size = _HEAD.unpack_from(body, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + size
        attitudes.append((VehicleId(system_id, component_id), body[begin:at]))
    return attitudes
