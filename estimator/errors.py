"""What a person may get wrong: the one exception for it, and small text files that they name."""

import stat
from pathlib import Path

LONGEST_FILE = 1 << 20  # bytes; a profile has some 4,000


class InputError(ValueError):
    """Raised for arguments, files and addresses that cannot be used.

    The message is one line for a person: what is wrong, and where. The command
    prints it and ends with status 2.
    """


def missing_extra(what: str, extra: str) -> InputError:
    """What to raise when ``what`` needs packages that only an extra brings."""
    clone = f"pip install -e '.[{extra}]' in a clone"
    return InputError(f"{what} needs the extra {extra!r}: {clone}, or pip install 'WHEEL[{extra}]'")


def file_text(path: Path, what: str) -> str:
    """The file's text, if it can be one: a pipe would block, a device may never end.

    Raises:
        FileNotFoundError: there is no such file.
        InputError: it is no file, too long, no text or cannot be read; begins with ``what``.
    """
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode) and not path.is_dir():
            raise InputError(f"{what}: not a file but a pipe, a socket or a device")
        if about.st_size == 0:  # some of the kernel's would block
            return ""
        with path.open("rb") as file:
            content = file.read(LONGEST_FILE + 1)
        if len(content) > LONGEST_FILE:
            raise InputError(f"{what}: has more than {LONGEST_FILE} bytes")
        return content.decode("utf-8-sig")  # as Windows' editors write it
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"{what}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{what}: not a text file (UTF-8)") from None
