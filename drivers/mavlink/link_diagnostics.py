"""Lines for the user about a link: that nothing arrives, or nothing readable, or an error again.

No clock is read; times come in as arguments, in s.
"""

from drivers.endpoint import Endpoint

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
