"""Whose messages ``run`` accepts: the options, and the checks that they switch on."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from estimator.errors import InputError

if TYPE_CHECKING:
    from drivers.endpoint import Endpoint
    from drivers.mavlink.gate import Policy

PANEL = "Security"
LONGEST_KEY_FILE = 4096  # bytes

AllowSystemIds = Annotated[
    str | None,
    typer.Option(
        "--allow-system-ids",
        metavar="IDS",
        help="Refuse frames of all other systems: 1,2,10-19.",
        rich_help_panel=PANEL,
    ),
]
SigningKeyFile = Annotated[
    Path | None,
    typer.Option(
        "--signing-key-file",
        metavar="FILE",
        help="Refuse frames not signed with the key (32 bytes, 64 hex digits) or phrase there.",
        rich_help_panel=PANEL,
    ),
]


class SecurityOptions(NamedTuple):
    """What was asked for. The key stays in its file until it is needed."""

    system_ids: frozenset[int] | None = None
    signing_key_file: Path | None = None

    def items(self) -> tuple[tuple[str, object], ...]:
        """The options with their values, None where one was not given."""
        return (
            ("--allow-system-ids", self.system_ids),
            ("--signing-key-file", self.signing_key_file),
        )


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


def require_link(options: SecurityOptions, endpoint: "Endpoint") -> None:
    """Refuse options that the built-in vehicle has no use for.

    Raises:
        InputError: names the option.
    """
    for option, value in options.items():
        if value is not None and endpoint.kind == "sim":
            raise InputError(f"{option} is for a MAVLink link, sim: has no frames")


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

    if key is None:
        return Policy(options.system_ids)
    from drivers.mavlink.signing import SigningCheck, state_path

    check = SigningCheck(key, state_path())
    stack.callback(check.close)
    return Policy(options.system_ids, check)


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
