"""What ``run`` shows a person: the table or lines, and what the drivers log."""

import logging
from collections.abc import Callable

from fuzzbee.run_options import RunOptions
from fuzzbee.terminal import PersonConsole, TerminalView


def open_view(options: RunOptions) -> TerminalView:
    """The view on standard output; with --json messages only, on standard error."""
    errors = PersonConsole(stderr=True)
    where = "" if options.no_zenoh else f" → {options.zenoh.prefix}/*"
    profile = "" if options.profile is None else f", {options.profile}"
    title = f"fuzzbee run {options.source}, {options.rate_hz:g} Hz{profile}{where}"
    view = TerminalView(errors if options.as_json else PersonConsole(), errors, title)
    _show_log(view.notify, verbose=options.verbose)
    return view


class _ViewHandler(logging.Handler):
    """Prints log lines through the view, so that they do not break up its table."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        super().__init__()
        self._say = notify

    def emit(self, record: logging.LogRecord) -> None:
        self._say(self.format(record))


def _show_log(notify: Callable[[str], None], *, verbose: bool) -> None:
    logger = logging.getLogger("drivers")
    logger.handlers = [_ViewHandler(notify)]
    logger.propagate = False
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # what happens to the link comes as events, once each; the log repeats it in detail
    logging.getLogger("drivers.mavlink.link").setLevel(logging.NOTSET if verbose else logging.ERROR)
