"""One endpoint kept open: packets in, bytes out, and what a person should know about it."""

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, wait

from drivers.aside import aside
from drivers.endpoint import Endpoint
from drivers.events import Event, LinkDown, LinkUp, Notice
from drivers.mavlink.transports.open import open_transport
from drivers.mavlink.transports.transport import SOCKET_BUFFER_BYTES, LinkError, Packet, unix_us
from estimator.errors import InputError

CLOSE_S = 0.5
# back-off between attempts; a vehicle that returns is read again within 1 s
FIRST_RETRY_S = 0.1
LONGEST_RETRY_S = 1.0
LOSS_LOOK_S = 0.25
LOSS_REPORT_S = 60.0

_logger = logging.getLogger(__name__)


class Connection:
    """A transport that is opened again after each failure.

    ``lost`` counts datagrams that the system threw away, ``is_open`` tells whether bytes may come.
    ``on_break`` is called whenever the connection breaks: half-read frames and peers are void then.
    """

    def __init__(self, endpoint: Endpoint, on_break: Callable[[], None]) -> None:
        self.endpoint = endpoint
        self.lost = 0
        self._transport = open_transport(endpoint)
        self._on_break = on_break
        self._events: list[Event] = []
        self._diagnostics = LinkDiagnostics(endpoint)
        self._errors = ErrorSummary()
        self._opening: Future[None] | None = None
        self.is_open = False
        self._is_up: bool | None = None  # None: nobody has been told yet
        self._has_data = False
        self._retry_s = FIRST_RETRY_S
        self._retry_due_s = 0.0
        self._losses = _Losses(endpoint)

    @property
    def address(self) -> str:
        """The address in use (with the real port, where 0 was bound)."""
        return self._transport.address

    def open(self) -> None:
        """Open the endpoint for the first time.

        Raises:
            InputError: the port is taken, the device missing or the host unknown.
        """
        try:
            self._transport.open()
            self.is_open = True
        except LinkError as error:
            self._note_break(str(error))
        except InputError:
            self._transport.close()
            raise

    def close(self) -> None:
        """Release the endpoint, within half a second."""
        self._count_lost(time.monotonic())
        self.is_open = False
        if self._opening is None:
            self._transport.close()
            return
        # a transport that opens later is closed at once
        self._opening.add_done_callback(lambda _: self._transport.close())
        wait([self._opening], CLOSE_S)

    def receive(self, wait_s: float) -> list[Packet]:
        """What has arrived, after waiting at most ``wait_s``."""
        if not self.is_open:
            self._reopen(wait_s)
            return []
        try:
            packets = self._transport.receive(wait_s)
        except LinkError as error:
            self._note_break(str(error))
            return []
        except OSError as error:  # no file descriptors left, or no memory
            self._note_break(error.strerror or str(error))
            return []
        if self._transport.connected != bool(self._is_up):
            self._note_state()
        now_s = time.monotonic()
        if packets:
            self._note_data()
        else:
            is_up = bool(self._is_up)
            self._tell(self._diagnostics.silence(now_s, is_up=is_up, has_data=self._has_data))
        if now_s >= self._losses.look_s:
            self._count_lost(now_s)
        return packets

    def note_read(self, size: int, frames: int) -> None:
        """So many bytes held so many frames."""
        self._tell(self._diagnostics.bytes_read(size, frames, time.monotonic()))

    def credit(self, peer: str) -> None:
        """A peer has sent IMU data: it keeps its place."""
        self._transport.credit(peer)

    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now is dropped."""
        if not self.is_open:
            return
        try:
            self._transport.send(data)
        except OSError as error:
            self._note_break(error.strerror or str(error))

    def take_events(self) -> list[Event]:
        """What has happened to the connection since the last call."""
        events, self._events = self._events, []
        return events

    def _reopen(self, wait_s: float) -> None:
        """Open again, some time after the last attempt."""
        if self._opening is None:
            left_s = self._retry_due_s - time.monotonic()
            if left_s > 0.0:
                time.sleep(min(left_s, wait_s))
                return
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
            # to look a name up may take many seconds, and a device may be as slow
            self._opening = aside(self._transport.open, "mavlink-opening")
        if not wait([self._opening], wait_s).done:
            return
        error, self._opening = self._opening.exception(), None
        if error is None:
            self.is_open = True
        elif isinstance(error, LinkError | InputError):
            self._note_break(str(error))
        elif isinstance(error, OSError):
            self._note_break(error.strerror or str(error))
        else:
            raise error

    def _note_state(self) -> None:
        """The transport began or ceased to be connected."""
        if self._is_up:
            self._tell_down("the last client has left")
            return
        self._is_up = True
        self._events.append(LinkUp(unix_us(), str(self.endpoint)))

    def _note_data(self) -> None:
        """Only bytes show that a link works: a server may accept and close at once."""
        if self._has_data:
            return
        self._has_data, self._retry_s = True, FIRST_RETRY_S
        attempts = self._errors.clear()
        after = f" after {attempts} failed attempts" if attempts else ""
        _logger.info("%s: data arrives%s", self.endpoint, after)

    def _note_break(self, reason: str) -> None:
        if self.is_open:
            self._count_lost(time.monotonic())
        self._losses.keep()
        self._retry_due_s = time.monotonic() + self._retry_s
        self._transport.close()
        self._on_break()
        self.is_open = self._has_data = False
        line = self._errors.line(reason, time.monotonic())
        if line is not None:
            _logger.warning("%s: %s; trying again", self.endpoint, line)
        if self._is_up is not False:
            self._tell_down(reason)

    def _tell_down(self, reason: str) -> None:
        self._is_up = False
        self._events.append(LinkDown(unix_us(), str(self.endpoint), reason))

    def _tell(self, text: str | None) -> None:
        if text is not None:
            self._events.append(Notice(None, unix_us(), text))

    def _count_lost(self, now_s: float) -> None:
        if self.is_open:
            self._tell(self._losses.line(self._transport.lost, now_s))
            self.lost = self._losses.total


class _Losses:
    """Datagrams that the system threw away, and the line about them, once a minute at most."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.total = 0
        self.look_s = 0.0  # when to look next
        self._endpoint = endpoint
        self._before = 0  # by transports that are closed
        self._reported = 0
        self._report_due_s = 0.0

    def line(self, of_transport: int, now_s: float) -> str | None:
        """Count what this transport has lost so far; a line if it is time for one."""
        self.look_s = now_s + LOSS_LOOK_S
        self.total = self._before + of_transport
        if self.total == self._reported or now_s < self._report_due_s:
            return None
        self._report_due_s = now_s + LOSS_REPORT_S
        count, self._reported = self.total - self._reported, self.total
        return (
            f"{self._endpoint}: {count} datagrams were lost, the system had no room for them; "
            f"sysctl net.core.rmem_max={SOCKET_BUFFER_BYTES} gives it more"
        )

    def keep(self) -> None:
        """The transport is closed; the next one counts from nothing."""
        self._before = self.total


SILENT_S = 5.0  # after the link was opened, without a byte
# Noise of a wrong baud rate: so many bytes for so long, and not one readable frame
UNREADABLE_BYTES = 500
UNREADABLE_S = 2.0
REPEAT_S = 60.0  # an error that goes on is mentioned this often

ADVICE = {
    "udpin": "does the vehicle or the ground station send to this address?",
    "tcpin": "does the vehicle or the ground station send to this address?",
    "udpout": "perhaps nobody listens there",
    "tcp": "whoever answers there says nothing",
    "serial": "is the vehicle on, and the baud rate right?",
}
OTHER_BAUD = "another baud rate? 57600 (radios), 115200 (USB), 921600 (wired)"


class LinkDiagnostics:
    """One link's bytes and frames; each method returns a line for a person, or None."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._open_since_s: float | None = None
        self._is_silence_told = False
        self._unread_bytes = 0  # since the last readable frame
        self._unread_since_s = 0.0
        self._is_noise_told = False

    def silence(self, now_s: float, *, is_up: bool, has_data: bool) -> str | None:
        """Whether the link has been open for long without a byte; told once."""
        if not is_up or has_data:
            self._open_since_s = None
            return None
        if self._open_since_s is None:
            self._open_since_s = now_s
        if self._is_silence_told or now_s - self._open_since_s < SILENT_S:
            return None
        self._is_silence_told = True
        advice = ADVICE[self._endpoint.kind]
        return f"{self._endpoint}: nothing has arrived in {SILENT_S:g} s; {advice}"

    def bytes_read(self, size: int, frames: int, now_s: float) -> str | None:
        """After ``size`` bytes that held so many frames; told once until one can be read."""
        self._open_since_s = None
        if frames:
            self._unread_bytes, self._is_noise_told = 0, False
            return None
        if self._unread_bytes == 0:
            self._unread_since_s = now_s
        self._unread_bytes += size
        is_long = now_s - self._unread_since_s >= UNREADABLE_S
        if self._is_noise_told or not is_long or self._unread_bytes < UNREADABLE_BYTES:
            return None
        self._is_noise_told = True
        why = OTHER_BAUD if self._endpoint.kind == "serial" else "is it a MAVLink stream?"
        count = f"{self._unread_bytes} bytes and not one MAVLink frame"
        return f"{self._endpoint}: {count}: {why}"


class ErrorSummary:
    """Decides which repetitions of an error are worth a line. Time comes in as an argument."""

    def __init__(self) -> None:
        self._reason = ""
        self._count = 0
        self._said_s = 0.0

    def line(self, reason: str, now_s: float) -> str | None:
        """What to say about ``reason`` now: the reason, the reason with its count, or nothing."""
        if reason != self._reason:
            self._reason, self._count, self._said_s = reason, 1, now_s
            return reason
        self._count += 1
        if now_s - self._said_s < REPEAT_S:
            return None
        self._said_s = now_s
        return f"{reason} ({self._count} times)"

    def clear(self) -> int:
        """Forget the error, because it is over; returns how often it was seen."""
        count, self._reason, self._count = self._count, "", 0
        return count
