"""Values in CDR, little endian, as ROS 2 has them on the wire.

https://www.omg.org/spec/DDSI-RTPS, section 10: a header of four bytes; numbers are aligned to
their size, counted from behind the header; a text has its length with the zero at its end.
"""

from struct import pack

HEADER = b"\x00\x01\x00\x00"


class CdrWriter:
    """Appends one value after the other; ``message`` is what they are together."""

    def __init__(self) -> None:
        self._body = bytearray()

    @property
    def message(self) -> bytes:
        """Header and all values so far."""
        return HEADER + bytes(self._body)

    def put_byte(self, value: int) -> None:
        """One byte."""
        self._body += pack("<B", value)

    def put_count(self, value: int) -> None:
        """An unsigned number of 32 bits, as that of the elements that follow."""
        self._align(4)
        self._body += pack("<I", value)

    def put_stamp(self, unix_us: int) -> None:
        """A ``builtin_interfaces/Time``."""
        seconds, micros = divmod(unix_us, 1_000_000)
        self._align(4)
        self._body += pack("<iI", seconds, 1000 * micros)

    def put_text(self, text: str) -> None:
        """A string."""
        content = text.encode() + b"\0"
        self.put_count(len(content))
        self._body += content

    def put_numbers(self, *values: float) -> None:
        """Doubles."""
        self._align(8)
        self._body += pack(f"<{len(values)}d", *values)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
