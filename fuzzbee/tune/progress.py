"""The progress bar of a search: evaluations, best cost, time left."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from tuning.search import Search, SearchOptions


class ProgressBar(Progress):
    """A progress bar on standard error; it shows nothing where that is no terminal."""

    def __init__(self, options: SearchOptions) -> None:
        console = Console(stderr=True)
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("best cost {task.fields[best]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._search = self.add_task(options.algorithm, total=options.budget, best="-")

    def show(self, search: Search) -> None:
        """Show where the search is now."""
        best = f"{search.best_cost:.4f}"
        self.update(self._search, completed=search.evaluations, best=best)
