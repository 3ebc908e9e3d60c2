# ruff: noqa: D102 - what each method does is written once, at Transport
"""A serial line."""

import contextlib
import errno
import os
from typing import Any

from drivers.mavlink.transports.transport import RECEIVE_BYTES, Packet, Transport, unix_us
from estimator.errors import InputError

# Bytes that wait for a slow line; when it is full, new frames are dropped
MOST_UNSENT_SERIAL_BYTES = 2048


class SerialLine(Transport):
    """A serial device at a fixed baud rate, for us alone."""

    _port: Any = None  # None: closed

    def open(self) -> None:
        import serial

        path, baud = self._endpoint.path, self._endpoint.baud
        try:
            # a second reader would steal half the bytes
            options = {"exclusive": True} if os.name == "posix" else {}
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=0, **options)
        except (OSError, ValueError) as error:
            raise InputError(
                f"cannot open serial device {path}: {_serial_reason(error)}"
            ) from error

    def receive(self, timeout_s: float) -> list[Packet]:
        try:
            self._port.timeout = timeout_s
            data = self._port.read(1)
            data += self._port.read(min(self._port.in_waiting, RECEIVE_BYTES))
        except (OSError, TypeError) as error:  # TypeError: pyserial, closed while reading
            raise ConnectionError(_serial_reason(error)) from error
        return [Packet(str(self._endpoint), bytes(data), unix_us())] if data else []

    def send(self, data: bytes) -> None:
        try:
            if self._port.out_waiting + len(data) <= MOST_UNSENT_SERIAL_BYTES:
                self._port.write(data)
        except OSError as error:
            raise ConnectionError(_serial_reason(error)) from error

    def close(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None


def _serial_reason(error: BaseException) -> str:
    number = getattr(error, "errno", None)
    if "Could not configure port" in str(error):  # pyserial's words; the system's are in brackets
        return "not a serial device"
    if number in (errno.EAGAIN, errno.EACCES) and "lock" in str(error):
        return "in use by another program"
    return os.strerror(number) if number else str(error)
