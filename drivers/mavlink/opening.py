"""A transport that is opened while somebody else goes on with something else."""

import threading

from drivers.mavlink.transports.transport import Transport


class Opening:
    """Opens a transport in a thread of its own.

    To look a name up may take many seconds, and a device may be as slow. Until it is done, the
    transport belongs to that thread.
    """

    def __init__(self, transport: Transport) -> None:
        self.error: BaseException | None = None
        self._transport = transport
        self._lock = threading.Lock()
        self._is_unwanted = False
        self._thread = threading.Thread(target=self._open, name="mavlink-opening", daemon=True)
        self._thread.start()

    def is_done(self, timeout_s: float) -> bool:
        """Whether it has come to an end within that time; then ``error`` tells which."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def give_up(self, timeout_s: float) -> None:
        """Give up: a link that opens later is closed at once."""
        with self._lock:
            self._is_unwanted = True
        self._thread.join(timeout_s)

    def _open(self) -> None:
        try:
            self._transport.open()
        except BaseException as error:  # noqa: BLE001 - raised again by whoever asks
            self.error = error
        with self._lock:
            if self._is_unwanted:
                self._transport.close()
