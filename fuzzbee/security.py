"""Whose messages ``run`` accepts: the systems, and the key that signs their frames."""

import os
import stat
from contextlib import ExitStack
from pathlib import Path
from select import select

from drivers.mavlink.encoder import is_phrase, signing_key
from drivers.mavlink.gate import Policy
from drivers.mavlink.signing import SigningCheck, state_path
from estimator.errors import InputError
from fuzzbee.notify import notify
from fuzzbee.run import RunOptions

LONGEST_KEY_FILE = 4096  # bytes
PIPE_S = 5.0  # in which a program writes the key into a pipe
SHORT_PHRASE = 8  # characters; shorter ones are guessed


def parse_system_ids(text: str | None) -> frozenset[int] | None:
    """The numbers in a list like ``1,2,10-19``."""
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


def key_of(path: Path | None, *, is_insecure: bool) -> bytes | None:
    """The key in a file, if one was named; warns of a pass phrase that is short."""
    if path is None:
        return None
    content = _content(path, is_insecure=is_insecure)
    if is_phrase(content) and len(content.strip()) < SHORT_PHRASE:
        notify(
            f"the pass phrase in {path} has fewer than {SHORT_PHRASE} characters: easily guessed"
        )
    return signing_key(content)


def open_policy(options: RunOptions, stack: ExitStack) -> Policy:
    """The policy for frames: which systems are let in, and whether frames must be signed."""
    allowed = parse_system_ids(options.allow_system_ids)
    key = key_of(options.signing_key_file, is_insecure=options.insecure_key_file)
    if key is None:
        return Policy(allowed)
    check = SigningCheck(key, state_path())
    stack.callback(check.close)
    return Policy(allowed, check)


def _content(path: Path, *, is_insecure: bool) -> bytes:
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            is_ready, _, _ = select([file], [], [], PIPE_S)  # a pipe may have no writer
            os.set_blocking(file.fileno(), True)
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(LONGEST_KEY_FILE + 1) if is_ready else b""
    except OSError as error:
        raise InputError(f"cannot read the key file {path}: {error.strerror}") from error
    is_open = stat.S_ISREG(mode) and mode & (stat.S_IRWXO | stat.S_IWGRP)
    if is_open and not is_insecure and os.name == "posix":
        text = f"others may read the key file {path} (mode {mode & 0o777:04o})"
        raise InputError(f"{text}: chmod 600, or --insecure-key-file")
    if not content.strip():
        raise InputError(f"the key file {path} is empty")
    if len(content) > LONGEST_KEY_FILE:
        raise InputError(f"the key file {path} is too long for a key or a pass phrase")
    return content
