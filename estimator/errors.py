"""The one exception a person causes: bad arguments or bad input."""


class InputError(ValueError):
    """Raised for arguments, files and addresses that cannot be used.

    The message is one line for a person: what is wrong, and where. The command
    prints it and ends with status 2.
    """


def missing_extra(what: str, extra: str) -> InputError:
    """What to raise when ``what`` needs packages that only an extra brings."""
    clone = f"pip install -e '.[{extra}]' in a clone"
    return InputError(f"{what} needs the extra {extra!r}: {clone}, or pip install 'WHEEL[{extra}]'")
