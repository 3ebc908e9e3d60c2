"""What every benchmark has: its options, its tables, and a picture of one."""

import argparse
import json
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from drivers.logs.open import SUFFIXES
from estimator.errors import InputError
from fuzzbee.options import seed_range

T = TypeVar("T")
Row = dict[str, Any]
Tables = Mapping[str, Sequence[Row]]
Option = tuple[tuple[str, ...], dict[str, Any]]
MISSING = "not installed"
DATA = Path(__file__).parents[2] / "tests" / "data"
JSON = (("--json",), {"action": "store_true", "help": "one JSON object on standard output"})
SMOKE = (("--smoke",), {"action": "store_true", "help": "a few seconds, to see that it runs"})


class Point(NamedTuple):
    """A mark of a picture: which panel, which line of it, whose mark, and where."""

    panel: str
    line: str
    series: str
    value: float


def option(*names: str, **settings: Any) -> Option:
    """An option of a script, as ``ArgumentParser.add_argument`` takes it."""
    return names, settings


PLOT = option("--plot", type=Path, metavar="FILE", help="a picture; needs matplotlib")
seeds = seed_range  # as an option's type
# Folders with recordings, which ``recordings.chosen_sets`` reads.
FOLDERS = (
    option("folders", type=Path, nargs="*", metavar="DIR", help="with *.mat files"),
    option("--undisturbed", action="store_true", help="leave out what is disturbed"),
)


def benchmark(*options: Option) -> Callable[[Callable[[Namespace], Tables]], Callable[[], int]]:
    """A script of these options: its docstring is its help, and it runs if it is the program."""

    def of(tables: Callable[[Namespace], Tables]) -> Callable[[], int]:
        def main() -> int:
            made = argparse.ArgumentParser(
                description=tables.__globals__["__doc__"],
                formatter_class=argparse.RawDescriptionHelpFormatter,
            )
            for names, settings in (JSON, SMOKE, *options):
                made.add_argument(*names, **settings)
            given = made.parse_args()
            show(tables(given), as_json=given.json)
            return 0

        if tables.__module__ == "__main__":
            sys.exit(main())
        return main

    return of


def numbers(text: str) -> list[float]:
    """Numbers with commas between them, as an option's type."""
    return [float(each) for each in text.split(",") if each]


def names(known: Iterable[str], text: str) -> list[str]:
    """Names with commas between them.

    Raises:
        SystemExit: one of them is not known.
    """
    chosen, known = text.split(","), list(known)
    unknown = [name for name in chosen if name not in known]
    if unknown:
        raise SystemExit(f"{unknown[0]!r} is none of {', '.join(known)}")
    return chosen


def log_files(given: Iterable[Path]) -> list[Path]:
    """The logs in folders, and files given as such."""
    folders = (sorted(each.iterdir()) if each.is_dir() else [each] for each in given)
    return [path for paths in folders for path in paths if path.suffix in SUFFIXES]


def each_log(paths: Iterable[Path], read: Callable[[Path], T]) -> Iterator[tuple[Path, T]]:
    """Every log and what ``read`` makes of it; a line for one that cannot be read."""
    for path in paths:
        try:
            yield path, read(path)
        except InputError as error:
            print(error, file=sys.stderr)


def show(tables: Tables, *, as_json: bool) -> None:
    """Print tables by their titles, for people or as one JSON object.

    For people columns stand under their names, and what a row does not have is a dash.
    """
    if as_json:
        print(json.dumps(tables))
        return
    for title, rows in tables.items():
        print(f"\n{title}")
        columns = list(dict.fromkeys(name for row in rows for name in row))
        cells = [columns, *([text(row.get(name)) for name in columns] for row in rows)]
        widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
        for line in cells:
            padded = [cell.ljust(width) for cell, width in zip(line, widths, strict=True)]
            print("  ".join(padded).rstrip(), flush=True)


def text(value: Any) -> str:
    """A cell."""
    match value:
        case None:
            return "-"
        case bool() | int() | str():
            return str(value)
        case float():
            return f"{value:.3f}" if 0.1 <= abs(value) < 1e4 or value == 0.0 else f"{value:.3g}"
        case Mapping():
            return ", ".join(f"{name} {text(each)}" for name, each in value.items())
    return ", ".join(text(each) for each in value)


def draw(path: Path, points: Iterable[Point], label: str, *, is_log: bool = False) -> None:
    """Panels side by side, a line each for the same things, a mark for each value."""
    from matplotlib.figure import Figure

    points = list(points)
    panels, lines, series = (
        list(dict.fromkeys(column)) for column in list(zip(*points, strict=True))[:3]
    )
    size = (4.0 + 2.5 * len(panels), 0.3 * len(lines) + 1.6)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, panel in zip(axes, panels, strict=True):
        for i, name in enumerate(series):
            marks = [p for p in points if (p.panel, p.series) == (panel, name)]
            height = 0.5 * (i - 0.5 * (len(series) - 1)) / len(series)
            heights = [lines.index(p.line) + height for p in marks]
            ax.plot([p.value for p in marks], heights, "o", markersize=4.5, label=name)
        ax.set(title=panel, xlabel=label, xscale="log" if is_log else "linear")
        ax.grid(visible=True, axis="x", which="both", alpha=0.25)
    axes[0].set_yticks(range(len(lines)), lines)
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    figure.savefig(path, dpi=130)
