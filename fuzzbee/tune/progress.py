"""The progress bar of a search: evaluations, best cost, time left."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from tuning.search import Search, SearchOptions


class ProgressBar:
    """A progress bar on standard error; it shows nothing where that is no terminal."""

    def __init__(self, options: SearchOptions) -> None:
        console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("best cost {task.fields[best]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task(options.algorithm, total=options.budget, best="-")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def show(self, search: Search) -> None:
        """Show where the search is now."""
        self._progress.update(
            self._task, completed=search.evaluations, best=f"{search.best_cost:.4f}"
        )
