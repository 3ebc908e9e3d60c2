"""MAVLink 2 signatures, checked on receipt: https://mavlink.io/en/guide/message_signing.html.

A signature proves that its sender knows the key; its time stamp proves that the
frame is new. The last stamp of each stream is therefore kept in a file: what was
accepted before a restart is not accepted after it. The key itself is never kept.
"""

import hashlib
import hmac
import json
import logging
import os
from pathlib import Path
from typing import Literal

from drivers.frames import SIGNATURE_SIZE, Frame
from drivers.mavlink_encoder import SIGNING_EPOCH_US, SIGNING_TICK_US
from estimator.errors import InputError

SIGNATURE_BYTES = 6
TICKS_PER_S = 1_000_000 // SIGNING_TICK_US
OLDEST_TICKS = 60 * TICKS_PER_S  # a stamp further behind the host's clock is refused
# The file is ahead of what was accepted, so that it need not be written at every frame: after a
# crash a vehicle waits for at most this long. A regular end writes the exact stamps.
AHEAD_TICKS = 2 * TICKS_PER_S

Refusal = Literal["unsigned", "wrong_signature", "replayed", "signature_too_old"]
Stream = tuple[int, int, int]  # system, component, link

_logger = logging.getLogger(__name__)


def state_path() -> Path:
    """Where the stamps are kept: ``$XDG_STATE_HOME/fuzzbee/signing.json``."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "fuzzbee" / "signing.json"


class SigningCheck:
    """Says which frames to refuse. ``key`` has 32 bytes; ``file`` keeps the streams' stamps.

    Raises:
        InputError: the file cannot be read or written, or is no such file.
    """

    def __init__(self, key: bytes, file: Path) -> None:
        assert len(key) == 32
        self._key = key
        self._file = file
        self._kept = _read(file)  # as in the file: no accepted stamp is above it
        self._last = dict(self._kept)
        self._is_failing = False
        try:
            file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            _write(file, self._kept)
        except OSError as error:
            raise InputError(
                f"cannot keep the time stamps of signatures in {file}: {error.strerror or error}"
            ) from error

    def refusal(self, frame: Frame, unix_us: int) -> Refusal | None:
        """Why ``frame``, which arrived at ``unix_us``, is refused; None if it is good."""
        if not frame.is_signed:
            return "unsigned"
        data = frame.data
        signature = hashlib.sha256(self._key + data[:-SIGNATURE_BYTES]).digest()[:SIGNATURE_BYTES]
        if not hmac.compare_digest(signature, data[-SIGNATURE_BYTES:]):
            return "wrong_signature"
        block = data[-SIGNATURE_SIZE:]
        stream = (frame.system_id, frame.component_id, block[0])
        ticks = int.from_bytes(block[1:7], "little")
        if ticks <= self._last.get(stream, -1):
            return "replayed"
        if ticks < (unix_us - SIGNING_EPOCH_US) // SIGNING_TICK_US - OLDEST_TICKS:
            return "signature_too_old"
        self._last[stream] = ticks
        if ticks > self._kept.get(stream, -1):
            self._keep({**self._kept, stream: ticks + AHEAD_TICKS})
        return None

    def close(self) -> None:
        """Write the exact stamps: a vehicle need not wait after a regular restart."""
        self._keep(self._last)

    def _keep(self, stamps: dict[Stream, int]) -> None:
        self._kept = dict(stamps)
        try:
            _write(self._file, stamps)
        except OSError as error:
            if not self._is_failing:
                _logger.warning(
                    "cannot write %s: %s; after a restart, frames of now could be replayed",
                    self._file,
                    error.strerror or error,
                )
            self._is_failing = True
        else:
            self._is_failing = False


def _read(file: Path) -> dict[Stream, int]:
    try:
        content = json.loads(file.read_text("utf-8"))
        stamps = {_stream(name): int(ticks) for name, ticks in content.items()}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror or error}") from error
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise InputError(
            f"{file} is damaged: remove it if no frame of before can be replayed"
        ) from None
    return stamps


def _stream(name: str) -> Stream:
    system, component, link = (int(part) for part in name.split("-"))
    return system, component, link


def _write(file: Path, stamps: dict[Stream, int]) -> None:
    """All or nothing: a crash in between leaves the old file."""
    text = json.dumps({"-".join(map(str, stream)): ticks for stream, ticks in stamps.items()})
    fresh = file.with_name(f"{file.name}.{os.getpid()}")
    with fresh.open("w", encoding="utf-8") as out:
        out.write(text)
        out.flush()
        os.fsync(out.fileno())
    fresh.replace(file)
