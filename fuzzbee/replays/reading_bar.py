"""How far a log has been read, where standard error is a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from drivers.logs.log_file import LogFile
from fuzzbee.notify import printable


@contextmanager
def reading_bar(log: LogFile) -> Iterator[None]:
    """Show a bar from the second piece of the log on, until it has been read."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    name = TextColumn("{task.description}", markup=False)
    columns = (name, BarColumn(), DownloadColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        size = log.path.stat().st_size
        task = bar.add_task(printable(log.path.name), total=size, visible=False)

        def show(done_with: int) -> None:
            bar.update(task, completed=done_with, visible=done_with > 0)

        log.on_read = show
        try:
            yield
        finally:
            log.on_read = None
