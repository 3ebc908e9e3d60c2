"""Whose messages ``run`` accepts: the options, and the checks that they switch on."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from estimator.errors import InputError
from fuzzbee.options import panel

if TYPE_CHECKING:
    from drivers.mavlink.gate import Policy

LONGEST_KEY_FILE = 4096  # bytes

option = panel("Security")
_IDS = "Refuse frames of all other systems: 1,2,10-19."
_KEY = "Refuse frames not signed with the key (32 bytes, 64 hex digits) or phrase there."


class SecurityOptions(NamedTuple):
    """What was asked for. The key stays in its file until it is needed."""

    allow_system_ids: Annotated[str | None, option(_IDS, metavar="IDS")] = None
    signing_key_file: Annotated[Path | None, option(_KEY, metavar="FILE")] = None

    @property
    def given(self) -> list[str]:
        """The options that were given, by their names on the command line."""
        return [
            f"--{name.replace('_', '-')}" for name, v in self._asdict().items() if v is not None
        ]


def parse_system_ids(text: str | None) -> frozenset[int] | None:
    """The numbers in a list like ``1,2,10-19``.

    Raises:
        InputError: something in it is no number from 1 to 255, or no range of them.
    """
    if text is None:
        return None
    ids: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if dash else True)):
            raise InputError(f"--allow-system-ids {text!r}: should be like 1,2,10-19")
        low, high = int(first), int(last or first)
        if not 1 <= low <= high <= 255:
            raise InputError(f"--allow-system-ids {text!r}: ids are 1 to 255")
        ids.update(range(low, high + 1))
    return frozenset(ids)


def read_key(options: SecurityOptions) -> bytes | None:
    """The key of the file that was named, if one was.

    Raises:
        InputError: see :func:`key_content`.
    """
    if options.signing_key_file is None:
        return None
    from drivers.mavlink.encoder import signing_key

    return signing_key(key_content(options.signing_key_file))


def open_policy(options: SecurityOptions, key: bytes | None, stack: ExitStack) -> "Policy":
    """The policy for frames: which systems are let in, and whether frames must be signed.

    Raises:
        InputError: the file of time stamps cannot be used.
    """
    from drivers.mavlink.gate import Policy

    system_ids = parse_system_ids(options.allow_system_ids)
    if key is None:
        return Policy(system_ids)
    from drivers.mavlink.signing import SigningCheck, state_path

    check = SigningCheck(key, state_path())
    stack.callback(check.close)
    return Policy(system_ids, check)


def key_content(path: Path) -> bytes:
    """What is in a key file.

    Raises:
        InputError: it cannot be read, is empty, or too long to be one.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LONGEST_KEY_FILE + 1)
    except OSError as error:
        raise InputError(f"cannot read the key file {path}: {error.strerror}") from error
    if not content.strip():
        raise InputError(f"the key file {path} is empty")
    if len(content) > LONGEST_KEY_FILE:
        raise InputError(f"the key file {path} is too long for a key or a pass phrase")
    return content
