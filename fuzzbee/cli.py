"""The ``fuzzbee`` command: arguments in, an exit status out.

It imports next to nothing, so that a signal is answered as promised from the first moment on.
"""

from fuzzbee import sigint_guard  # noqa: I001 - before all others

import atexit
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from estimator.compilation.kernel_folder import notify_compiling
from estimator.errors import InputError
from fuzzbee.sigint_guard import INTERRUPTED, is_endless
from drivers.output_file import DISK_ERRORS, NotWholeError
from fuzzbee.notify import notify
from fuzzbee.environment import lacking_of_processor, settle_environment
from service.signals import interrupted_by, terminate_like_interrupt

sigint_guard.end()

OK, FAILED, BAD_INPUT = 0, 1, 2
STANDARD_ERROR = 2
UNWRITABLE = DISK_ERRORS | {errno.EBADF}  # of a standard output that is full or closed
LEAST_ALIKE = 0.7  # of an option that is suggested
# Names of threads that may hang: a sink on a stopped terminal, a session that waits for its peer
HANGING = ("sink ", "zenoh opener", "zenoh closer")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status and lets no exception out."""
    arguments = _spell_out(sys.argv[1:] if argv is None else argv)
    notify_compiling(notify)
    try:
        status = _run_verb(arguments)  # the parser, too, returns INTERRUPTED
    except (Exception, KeyboardInterrupt, SystemExit) as error:  # noqa: BLE001 - the last resort
        status = _status_of(error, is_verbose="-v" in arguments or "--verbose" in arguments)
    if status == INTERRUPTED:
        return OK if is_endless(arguments) else 128 + (interrupted_by() or signal.SIGINT)
    return status if isinstance(status, int) else OK


def _status_of(error: Any, *, is_verbose: bool) -> int:
    """The status after an error, ``INTERRUPTED`` after an interrupt; prints a line of it."""
    match error:
        # the reader of our output has seen enough; met in an output that was /dev/stdout it is an
        # InputError, and an exit if the parser met it
        case (
            BrokenPipeError()
            | InputError(__context__=BrokenPipeError())
            | SystemExit(__context__=BrokenPipeError())
        ):
            return OK
        case InputError():
            return _fail(str(error), BAD_INPUT)
        case NotWholeError():
            return _fail(str(error), FAILED)
        case SystemExit():
            raise error
        case _ if isinstance(error, KeyboardInterrupt) or interrupted_by() is not None:
            return INTERRUPTED  # inside a library, it may have become another error
        case _ if type(error).__name__ == "NoArgsIsHelpError":  # a group of verbs without a verb
            print(error.format_message(), file=sys.stderr)
            return BAD_INPUT
        # what the parser refused; its classes moved between versions
        case _ if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            return _fail(_in_our_words(error), BAD_INPUT)
        case OSError(errno=errno.ENAMETOOLONG):
            return _fail(f"{error.filename}: {error.strerror}", BAD_INPUT)  # of any option
        case OSError(filename=None) if error.errno in UNWRITABLE:
            return _fail(f"standard output: {error.strerror}", FAILED)
    if is_verbose:
        import traceback

        traceback.print_exc()
    return _fail(f"{type(error).__name__}: {error}", FAILED)


def _spell_out(arguments: Sequence[str]) -> list[str]:
    """``--view`` alone means a window; the parser has no optional values.

    A word behind it is its value, unless it may be a source or a log that comes after it.
    """
    following = [*arguments[1:], ""]
    may_be_view = [after.isalpha() and not Path(after).exists() for after in following]
    return [
        "--view=window" if word == "--view" and not has_view else word
        for word, has_view in zip(arguments, may_be_view, strict=False)
    ]


def _run_verb(arguments: list[str]) -> object:
    """What the verb returned; SIGTERM interrupts it as SIGINT does."""
    with terminate_like_interrupt():
        from fuzzbee.app import build_command

        command = build_command(decorated=sys.stdout.isatty() and not os.environ.get("NO_COLOR"))
        return command.main(args=arguments, prog_name="fuzzbee", standalone_mode=False)


def entry_point() -> None:
    """The ``fuzzbee`` command."""
    _replace_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # one of somebody else's making
            # letters that it has no code for become question marks, not the end of its lines
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    if lacking := lacking_of_processor():
        _end(_fail(f"this processor has no {', '.join(lacking)}: numpy needs x86-64-v2", FAILED))
    if (taken := settle_environment()) is not None:
        notify(taken)
    status = main()
    if any(thread.name.startswith(HANGING) for thread in threading.enumerate()):
        os._exit(status)
    _end(status)


def _end(status: int) -> None:
    """Leave with this status, whatever has been interrupted.

    Dataclasses and named tuples are made by ``exec`` of a text. If a ``KeyboardInterrupt`` was
    raised in there, Python ends by SIGINT, even if it was handled. So what has to be done at the
    end is done here, and Python's own end is left out.
    """
    threading._shutdown()  # type: ignore[attr-defined]  # noqa: SLF001 - joins threads
    atexit._run_exitfuncs()  # noqa: SLF001
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed by its reader
            stream.flush()
    os._exit(status)


def _replace_closed_streams() -> None:
    """A supervisor may start us with closed outputs; Python has None for them.

    The next file to be opened would take such a stream's number, and a recording what libraries
    and the processes that we start print there.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= STANDARD_ERROR:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stdout is None:
        # a service goes on; of other verbs, and of JSON, the output is what they are for
        is_service = is_endless(sys.argv[1:]) and "--json" not in sys.argv
        sys.stdout = Path(os.devnull).open("w") if is_service else _ClosedOutput()  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115


class _ClosedOutput(io.TextIOBase):
    """Stands for a standard output that was closed before the start."""

    def write(self, _text: str, /) -> int:
        """Raise OSError: nobody would ever see it."""
        raise OSError(errno.EBADF, "it is closed")


def _in_our_words(error: Any) -> str:
    """What the parser refused; it suggests only options that look like what was written."""
    value, is_number, kind = getattr(error, "message", "").partition(" is not a valid ")
    parameter = getattr(error, "param", None)
    if is_number and parameter is not None:
        wanted = {"float.": "a number", "int.": "a whole number"}.get(kind, kind)
        return f"{parameter.opts[0]} {value[1:-1]}: should be {wanted}"
    written = getattr(error, "option_name", "") or ""
    error.possibilities = [
        each
        for each in getattr(error, "possibilities", None) or ()
        if SequenceMatcher(None, written.strip("-"), each.strip("-")).ratio() >= LEAST_ALIKE
    ]
    return str(error.format_message())


def _fail(text: str, status: int) -> int:
    notify(" ".join(text.split()))
    return status
