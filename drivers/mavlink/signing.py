"""MAVLink 2 signatures, checked on receipt: https://mavlink.io/en/guide/message_signing.html.

A signature proves that its sender knows the key; its time stamp proves that the
frame is new. The last stamp of each stream is therefore kept in a file: what was
accepted before a restart is not accepted after it, and what we sign after it is above
what we signed before, even if the host's clock was set back. The key itself is never kept.
"""

import hashlib
import hmac
import logging
import os
from concurrent.futures import Future
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec

from drivers.mavlink.encoder import SIGNING_EPOCH_US, SIGNING_TICK_US
from drivers.mavlink.framing import SIGNATURE_SIZE, Frame
from drivers.output_file import written_whole
from drivers.resources import run_in_thread
from estimator.errors import InputError
from estimator.reasons import Reason

SIGNATURE_BYTES = 6
TICKS_PER_S = 1_000_000 // SIGNING_TICK_US
# A stamp fits if it is no further than this behind the host's clock, or if its distance from that
# has changed by no more since its stream's last one: some senders count frames instead of
# time. Older ones may be replays of what did not arrive here.
FITTING_TICKS = 60 * TICKS_PER_S
# A host without a battery for its clock is behind by as long as it was off. A stamp further ahead
# than this is nonsense, and once accepted would lock its own sender out.
AHEAD_LIMIT_TICKS = 365 * 86_400 * TICKS_PER_S
Ticks = Annotated[int, msgspec.Meta(ge=0, lt=1 << 48)]
# The file is ahead of what was accepted, so that it need not be written at every frame: after a
# crash a vehicle waits for at most this long. A regular end writes the exact stamps.
AHEAD_TICKS = 2 * TICKS_PER_S
SHORTEST_TICKS = TICKS_PER_S // 100  # a pace is judged over at least that

OURS, FLOOR = "ours", "floor"  # in the file, beside the streams' names
# Above that many streams, those whose stamps are too old to fit are kept as one: the latest of
# their stamps is a floor for streams that are not known (any more).
MOST_STREAMS = 1024

Stream = tuple[int, int, int]  # system, component, link

_logger = logging.getLogger(__name__)


def state_path() -> Path:
    """Where the stamps are kept: ``$XDG_STATE_HOME/fuzzbee/signing.json``."""
    base = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not base.is_absolute():  # nothing of the current folder's counts
        try:
            base = Path.home() / ".local" / "state"
        except RuntimeError:
            text = "signing: no home directory for the stamps: set XDG_STATE_HOME"
            raise InputError(text) from None
    return base / "fuzzbee" / "signing.json"


class Accepted(NamedTuple):
    """The last stamp accepted of a stream, and how far behind the host's clock it was."""

    ticks: Ticks
    lag: int


class Stamps(NamedTuple):
    """What was accepted, and the last stamp of ours."""

    accepted: dict[Stream, Accepted]
    ours: int
    floor: int = 0  # at or under it nothing of a stream that is not in ``accepted`` is new


class SigningCheck:
    """Decides which frames to refuse, and stamps ours.

    ``key`` has 32 bytes; ``file`` keeps the stamps, and those of other processes beside them.

    Raises:
        InputError: the file cannot be read or written, or is no such file.
    """

    def __init__(self, key: bytes, file: Path) -> None:
        assert len(key) == 32
        self.key = key
        self._file = file
        self._kept = _read(file)  # as in the file: no accepted stamp is above it, and none of ours
        self._last = dict(self._kept.accepted)
        self._ours = self._kept.ours
        self._floor = self._kept.floor
        self._most_streams = MOST_STREAMS
        self._writing: Future[Stamps] | None = None  # by a thread of its own
        self._own: set[Stream] = set()  # accepted by this process
        self._fresh: set[Stream] = set()  # of them, since the file was looked after
        self._written: dict[Stream, Accepted] = {}  # as accepted when the file was written
        self._is_failing = False
        try:
            file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            _write(file, self._kept)
        except OSError as error:
            raise InputError(
                f"cannot keep the time stamps of signatures in {file}: {error.strerror or error}"
            ) from error

    def refusal(self, frame: Frame, unix_us: int) -> Reason | None:
        """Why ``frame``, which arrived at ``unix_us``, is refused; None if it is good.

        What is good may be used after :meth:`keep_ahead`.
        """
        if not frame.is_signed:
            return Reason.UNSIGNED
        data = frame.data
        signature = hashlib.sha256(self.key + data[:-SIGNATURE_BYTES]).digest()[:SIGNATURE_BYTES]
        if not hmac.compare_digest(signature, data[-SIGNATURE_BYTES:]):
            return Reason.WRONG_SIGNATURE
        block = data[-SIGNATURE_SIZE:]
        stream = (frame.system_id, frame.component_id, block[0])
        ticks = int.from_bytes(block[1:7], "little")
        last = self._last.get(stream)
        if ticks <= (self._floor if last is None else last.ticks):
            return Reason.REPLAYED
        lag = _ticks(unix_us) - ticks
        if -lag > AHEAD_LIMIT_TICKS:
            return Reason.SIGNATURE_TOO_NEW
        if lag > FITTING_TICKS and (last is None or abs(lag - last.lag) > FITTING_TICKS):
            return Reason.SIGNATURE_TOO_OLD
        self._last[stream] = Accepted(ticks, lag)
        self._own.add(stream)
        if len(self._last) > self._most_streams:
            self._merge_old(_ticks(unix_us))
        self._fresh.add(stream)
        return None

    def keep_ahead(self, unix_us: int) -> None:
        """Have the file be ahead of what was accepted, before that is used.

        The disk is waited for only if it is late. Streams that begin are covered by a floor of its
        own, ahead of the host's clock: one write a second does for any number of them.
        """
        fresh, now = self._fresh, _ticks(unix_us)
        self._fresh = set()
        is_new = any(self._is_new(stream, now) for stream in fresh)
        if self._writing is not None and (self._writing.done() or is_new):
            self._settle()
        if self._writing is not None or not any(self._is_due(stream, now) for stream in fresh):
            return
        floor = max(self._floor, now + AHEAD_TICKS)
        stamps = Stamps(self._stamps_ahead(floor), self._kept.ours, floor)
        self._writing = run_in_thread(lambda: self._write(stamps), "signing stamps")
        if any(self._is_new(stream, now) for stream in fresh):
            self._settle()

    def _is_due(self, stream: Stream, now: int) -> bool:
        """Whether the file has to be written anew: half-way to the stamp that it keeps."""
        kept, written = self._kept.accepted.get(stream), self._written.get(stream)
        if kept is None:
            return self._is_new(stream, now + AHEAD_TICKS // 2)
        return written is None or self._last[stream].ticks > (kept.ticks + written.ticks) // 2

    def _is_new(self, stream: Stream, now: int) -> bool:
        """Whether the file does not show yet that the stream's last stamp is an old one.

        Who is left to the floor has a stamp in it when that is past: else one that counts frames,
        and falls behind the clock, would be taken for an old one after a crash, for good.
        """
        kept, ticks = self._kept.accepted.get(stream), self._last[stream].ticks
        return max(ticks, now) > self._kept.floor if kept is None else ticks > kept.ticks

    def stamp(self, unix_us: int) -> int:
        """The stamp for a frame of ours: above all before it, also those before a restart."""
        self._ours = max(self._ours + 1, _ticks(unix_us))
        if self._ours > self._kept.ours:
            self._settle()
            self._kept = self._write(self._kept._replace(ours=self._ours + AHEAD_TICKS))
        return self._ours

    def close(self) -> None:
        """Write the exact stamps: a vehicle need not wait after a regular restart."""
        self._settle()
        self._kept = self._write(Stamps(dict(self._last), self._ours, self._floor))

    def _merge_old(self, now: int) -> None:
        """Keep one floor for all streams that would be too old to be taken as new ones.

        One whose clock is off would be taken, or refused, otherwise: it is kept by itself.
        """
        old = {
            stream: at.ticks
            for stream, at in self._last.items()
            if abs(at.lag) <= FITTING_TICKS < now - at.ticks
        }
        self._floor = max([self._floor, *old.values()])
        for stream in old:
            del self._last[stream]
            self._written.pop(stream, None)
            self._own.discard(stream)
            self._fresh.discard(stream)
        self._most_streams = max(MOST_STREAMS, 2 * len(self._last))

    def _stamps_ahead(self, floor: int) -> dict[Stream, Accepted]:
        """The streams' stamps as they will be in two seconds, each at its own pace.

        One that came too short a time ago to show its pace is left to the floor, or keeps its
        stamp: else each new stream would take the others' lead away, and the file were written at
        every frame.
        """
        kept, ahead = self._kept.accepted, {}
        for stream, last in self._last.items():
            written = self._written.setdefault(stream, last)
            ticks = last.ticks - written.ticks
            host_ticks = ticks + last.lag - written.lag
            if host_ticks < SHORTEST_TICKS:
                at = kept.get(stream)
                if at is not None or last.ticks > floor:
                    ahead[stream] = last._replace(ticks=max(last.ticks, at.ticks if at else 0))
                continue
            ahead[stream] = last._replace(
                ticks=last.ticks + min(AHEAD_TICKS * ticks // host_ticks, AHEAD_TICKS)
            )
            self._written[stream] = last
        return ahead

    def _settle(self) -> None:
        """Wait for what is being written."""
        if self._writing is not None:
            self._kept = self._writing.result()
            self._writing = None

    def _write(self, stamps: Stamps) -> Stamps:
        try:
            _write(self._file, self._add_others(stamps))
        except (OSError, InputError) as error:
            if not self._is_failing:
                _logger.warning(
                    "cannot write %s: %s; after a restart, frames of now could be replayed",
                    self._file,
                    getattr(error, "strerror", None) or error,
                )
            self._is_failing = True
        else:
            self._is_failing = False
        return stamps

    def _add_others(self, stamps: Stamps) -> Stamps:
        """And of the streams not accepted here what another process may have kept."""
        found = _read(self._file)
        floor = max(stamps.floor, found.floor)
        others = {
            stream: at
            for stream, at in found.accepted.items()
            if stream not in self._own and (at.ticks > self._floor or abs(at.lag) > FITTING_TICKS)
        }
        return Stamps({**stamps.accepted, **others}, max(stamps.ours, found.ours), floor)


def _ticks(unix_us: int) -> int:
    return (unix_us - SIGNING_EPOCH_US) // SIGNING_TICK_US


def _read(file: Path) -> Stamps:
    try:
        content = msgspec.json.decode(file.read_bytes(), type=dict[str, Ticks | Accepted])
        ours, floor = (msgspec.convert(content.pop(name, 0), Ticks) for name in (OURS, FLOOR))
        names = [msgspec.convert(name.split("-"), Stream, strict=False) for name in content]
        accepted = msgspec.convert(list(content.values()), list[Accepted])
    except FileNotFoundError:
        return Stamps({}, 0)
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror or error}") from error
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        raise InputError(
            f"{file} is damaged: remove it if no frame of before can be replayed"
        ) from None
    return Stamps(dict(zip(names, accepted, strict=True)), ours, floor)


def _write(file: Path, stamps: Stamps) -> None:
    """All or nothing: a crash in between leaves the old file."""
    named = {"-".join(map(str, stream)): at for stream, at in stamps.accepted.items()}
    with written_whole(file) as fresh:
        fresh.write_bytes(msgspec.json.encode({**named, OURS: stamps.ours, FLOOR: stamps.floor}))
