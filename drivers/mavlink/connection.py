"""One endpoint kept open: packets in, bytes out, how many a peer may send, and what to report."""

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from math import inf

from drivers.endpoint import Endpoint
from drivers.events import Event, LinkDown, LinkUp, Notice
from drivers.mavlink.transports.serial import SerialLine
from drivers.mavlink.transports.tcp import TcpClient, TcpServer
from drivers.mavlink.transports.transport import SOCKET_BUFFER_BYTES, Packet, Transport, unix_us
from drivers.mavlink.transports.udp import Udp
from drivers.resources import run_in_thread
from estimator.errors import InputError

TRANSPORTS: dict[str, Callable[[Endpoint], Transport]] = {
    "udpin": Udp,
    "udpout": Udp,
    "tcp": TcpClient,
    "tcpin": TcpServer,
    "serial": SerialLine,
}
CLOSE_S = 0.5
# back-off between attempts; a vehicle that returns is read again within 1 s
FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0
LOSS_LOOK_S = 0.25
REPEAT_S = 60.0  # an error or a loss that goes on is mentioned this often

_logger = logging.getLogger(__name__)


class Connection:
    """A transport that is opened again after each failure.

    ``breaks`` counts the failures, ``lost`` the datagrams that the system has thrown away, as of
    the last look for them; ``is_open`` is whether bytes may come, ``was_up`` whether any could
    ever. ``on_break`` is called whenever the connection breaks: half-read frames and peers
    are void then. ``report`` gets a line for each new kind of failure.

    Raises:
        InputError: the endpoint is neither a socket nor a serial line.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        on_break: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = _logger.warning,
    ) -> None:
        self.endpoint = endpoint
        self.is_open = self.was_up = False
        self.breaks = self.lost = 0
        if endpoint.kind not in TRANSPORTS:
            raise InputError(f"{endpoint} is no MAVLink link: use udpin, udpout, tcp or tcpin")
        self._transport = TRANSPORTS[endpoint.kind](endpoint)
        self._on_break, self._report = on_break, report
        self._events: list[Event] = []
        self._diagnostics = LinkDiagnostics(endpoint)
        self._loss_look_s = 0.0  # when to look for losses next
        self._lost_before = 0  # by transports that are closed
        self._opening: Future[None] | None = None
        self._is_up: bool | None = None  # None: no event has been given yet
        self._has_data = False
        self._retry_s, self._retry_due_s = FIRST_RETRY_S, 0.0

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
        except OSError as error:
            self._note_break(error)

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
        except OSError as error:  # the link broke, or no file descriptors or memory are left
            self._note_break(error)
            return []
        if self._transport.connected and not self._is_up:
            self._is_up = self.was_up = True
            self._events.append(LinkUp(unix_us(), str(self.endpoint)))
        elif self._is_up and not self._transport.connected:
            self._note_down("the last client has left")
        now_s = time.monotonic()
        if not packets:
            is_silent = bool(self._is_up) and not self._has_data
            self._notify(self._diagnostics.silence(now_s, is_silent=is_silent))
        elif not self._has_data:  # only bytes show that a link works: a server may close at once
            self._has_data, self._retry_s = True, FIRST_RETRY_S
            attempts = self._diagnostics.end_failures()
            after = f" after {attempts} failed attempts" if attempts else ""
            _logger.info("%s: data arrives%s", self.endpoint, after)
        if now_s >= self._loss_look_s:
            self._count_lost(now_s)
        return packets

    def note_read(self, size: int, frames: int) -> None:
        """So many bytes held so many frames."""
        self._notify(self._diagnostics.bytes_read(size, frames, time.monotonic()))

    def credit(self, peer: str) -> None:
        """A peer has sent IMU data: it keeps its slot, where there are not as many as peers."""
        if isinstance(self._transport, TcpServer):
            self._transport.credit(peer)

    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now is dropped."""
        if not self.is_open:
            return
        try:
            self._transport.send(data)
        except OSError as error:
            self._note_break(error)

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
            self._opening = run_in_thread(self._transport.open, "mavlink-opening")
        if not wait([self._opening], wait_s).done:
            return
        error, self._opening = self._opening.exception(), None
        if error is None:
            self.is_open = True
        elif isinstance(error, OSError | InputError):
            self._note_break(error)
        else:
            raise error

    def _note_break(self, error: OSError | InputError) -> None:
        reason, now_s = getattr(error, "strerror", None) or str(error), time.monotonic()
        self.breaks += 1
        self._count_lost(now_s)
        self._lost_before = self.lost
        self._retry_due_s = now_s + self._retry_s
        self._transport.close()
        self._on_break()
        self.is_open = self._has_data = False
        if (line := self._diagnostics.failure(reason, now_s)) is not None:
            self._report(line)
        if self._is_up is not False:
            self._note_down(reason)

    def _note_down(self, reason: str) -> None:
        self._is_up = False
        self._events.append(LinkDown(unix_us(), str(self.endpoint), reason))

    def _notify(self, text: str | None) -> None:
        if text is not None:
            self._events.append(Notice(None, unix_us(), text))

    def _count_lost(self, now_s: float) -> None:
        self._loss_look_s = now_s + LOSS_LOOK_S
        if self.is_open:
            self.lost = self._lost_before + self._transport.lost
            self._notify(self._diagnostics.losses(self.lost, now_s))


SILENT_S = 5.0  # after the link was opened, without a byte
# Noise of a wrong baud rate: so many bytes for so long, and not one readable frame
UNREADABLE_BYTES = 500
UNREADABLE_S = 2.0

ADVICE = {
    "udpin": "does the vehicle or the ground station send to this address?",
    "tcpin": "does the vehicle or the ground station send to this address?",
    "udpout": "perhaps nobody listens there",
    "tcp": "the program that answers there sends nothing",
    "serial": "is the vehicle on, and the baud rate right?",
}
OTHER_BAUD = "another baud rate? 57600 (radios), 115200 (USB), 921600 (wired)"


class LinkDiagnostics:
    """What a person should know about one link; each method returns a line for them, or None."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._silent_since_s = inf
        self._is_silence_reported = False
        self._unread_bytes = 0  # since the last readable frame
        self._unread_since_s = inf
        self._is_noise_reported = False
        self._lost_reported, self._loss_due_s = 0, 0.0
        self._failure, self._failures, self._failure_due_s = "", 0, 0.0

    def silence(self, now_s: float, *, is_silent: bool) -> str | None:
        """Whether the link has been open for long without a byte; reported once."""
        self._silent_since_s = min(self._silent_since_s, now_s) if is_silent else inf
        if self._is_silence_reported or now_s - self._silent_since_s < SILENT_S:
            return None
        self._is_silence_reported = True
        advice = ADVICE[self._endpoint.kind]
        return f"{self._endpoint}: nothing has arrived in {SILENT_S:g} s; {advice}"

    def bytes_read(self, size: int, frames: int, now_s: float) -> str | None:
        """After ``size`` bytes that held so many frames; reported once until one can be read."""
        self._silent_since_s = inf
        if frames:
            self._unread_bytes, self._unread_since_s, self._is_noise_reported = 0, inf, False
            return None
        self._unread_bytes += size
        self._unread_since_s = min(self._unread_since_s, now_s)
        is_long = now_s - self._unread_since_s >= UNREADABLE_S
        if self._is_noise_reported or not is_long or self._unread_bytes < UNREADABLE_BYTES:
            return None
        self._is_noise_reported = True
        why = OTHER_BAUD if self._endpoint.kind == "serial" else "is it a MAVLink stream?"
        count = f"{self._unread_bytes} bytes and not one MAVLink frame"
        return f"{self._endpoint}: {count}: {why}"

    def losses(self, lost: int, now_s: float) -> str | None:
        """After so many datagrams were lost in all; reported once a minute at most."""
        count = lost - self._lost_reported
        if not count or now_s < self._loss_due_s:
            return None
        self._lost_reported, self._loss_due_s = lost, now_s + REPEAT_S
        return (
            f"{self._endpoint}: {count} datagrams were lost, the system had no room for them; "
            f"sysctl net.core.rmem_max={SOCKET_BUFFER_BYTES} gives it more"
        )

    def failure(self, reason: str, now_s: float) -> str | None:
        """After the transport failed; reported at once, and once a minute while it goes on."""
        if reason != self._failure:
            self._failure, self._failures, self._failure_due_s = reason, 0, now_s
        self._failures += 1
        if now_s < self._failure_due_s:
            return None
        self._failure_due_s = now_s + REPEAT_S
        times = f" ({self._failures} times)" if self._failures > 1 else ""
        return f"{self._endpoint}: {reason}{times}; trying again"

    def end_failures(self) -> int:
        """Forget the failure, because it is over; returns how often it occurred."""
        count, self._failure, self._failures = self._failures, "", 0
        return count


PACKETS_HZ = 200.0  # of a peer without an IMU; a ground station sends a tenth of that
ALL_PACKETS_HZ = 2000.0  # of all those together
IMU_PACKETS_HZ = 30_000.0  # of a peer with an IMU; a router may forward 200 vehicles
IMU_COUNTS_S = 5.0  # a peer counts as one with an IMU for so long after a sample
FRAME_BYTES = 64  # of a usual frame: a packet that is larger counts as several
MOST_PEERS = 1024


@dataclass(slots=True)
class _Budget:
    """A second's worth of packets, refilled as time goes by."""

    left: float
    at_s: float
    imu_s: float = -inf  # when its peer last sent IMU data

    def take(self, packets: int, rate_hz: float, now_s: float) -> bool:
        """Whether there are so many left, which are then taken; a full one is enough for any."""
        left = self.left + rate_hz * max(0.0, now_s - self.at_s)  # the clock may be set
        self.left, self.at_s = min(rate_hz, left), now_s
        packets = min(packets, int(rate_hz))
        if self.left < packets:
            return False
        self.left -= packets
        return True

    def has_imu(self, now_s: float) -> bool:
        """Whether its peer has sent IMU data lately."""
        return now_s - self.imu_s < IMU_COUNTS_S


class RateLimits:
    """Decides whether a peer's packet is read; ``refused`` counts those that are not.

    A flood of heartbeats costs as much to read as samples do. So each peer without an IMU has a
    budget of packets a second, and all of them together have one. A peer that sends IMU data has a
    larger budget of its own, so that nobody else's flood keeps its samples out.
    Times are those of the packets' arrival, in s: nobody is refused because this process has not
    looked for a while.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._peers: dict[str, _Budget] = {}
        self._all = _Budget(ALL_PACKETS_HZ, 0.0)

    def admits(self, peer: str, size: int, now_s: float) -> bool:
        """Whether a packet of ``size`` bytes is read that arrived at ``now_s``."""
        known = self._peers.get(peer)
        if known is None:
            if len(self._peers) >= MOST_PEERS:  # the budget of all without an IMU still holds
                self._peers = {k: p for k, p in self._peers.items() if p.has_imu(now_s)}
            known = self._peers[peer] = _Budget(PACKETS_HZ, now_s)
        packets = 1 + size // FRAME_BYTES
        has_imu = known.has_imu(now_s)
        is_admitted = known.take(packets, IMU_PACKETS_HZ if has_imu else PACKETS_HZ, now_s)
        if is_admitted and not has_imu:
            is_admitted = self._all.take(packets, ALL_PACKETS_HZ, now_s)
        self.refused += not is_admitted
        return is_admitted

    def note_imu(self, peer: str, now_s: float) -> None:
        """IMU data of ``peer``, just admitted, was let in; the first fills its larger budget."""
        known = self._peers[peer]
        if not known.has_imu(now_s):
            known.left = IMU_PACKETS_HZ
        known.imu_s = now_s
