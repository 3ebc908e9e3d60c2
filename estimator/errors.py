"""The one exception a person causes: bad arguments or bad input."""


class InputError(ValueError):
    """Raised for arguments, files and addresses that cannot be used.

    The message is one line for a person: what is wrong, and where. The command
    prints it and ends with status 2.
    """
