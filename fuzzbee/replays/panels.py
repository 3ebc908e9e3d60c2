"""What a figure shows, panel by panel: ``figure`` draws it for paper, ``page`` for browsers."""

from dataclasses import dataclass, field
from typing import NamedTuple

from estimator.arrays import Floats

BLUE, ORANGE, GREEN, RED, PURPLE, BROWN = (
    *("#1f77b4", "#ff7f0e", "#2ca02c"),
    *("#d62728", "#9467bd", "#8c564b"),
)
GREY, DARK, BLACK = "#cccccc", "#595959", "#262626"

Span = tuple[float, float]


class Curve(NamedTuple):
    """A line through points (N,), broken where one is NaN; ``dash`` as matplotlib has it."""

    x: Floats
    y: Floats
    color: str
    label: str = ""
    width: float = 0.8
    dash: str = "-"


class Area(NamedTuple):
    """What lies between two curves (N,) of the same x (N,)."""

    x: Floats
    low: Floats
    high: Floats
    color: str
    alpha: float
    label: str = ""


class Band(NamedTuple):
    """Spans of x that are shaded over the whole height."""

    label: str
    color: str
    alpha: float
    spans: list[Span]


class Mark(NamedTuple):
    """A moment: a line over the whole height, with its name beside it."""

    x: float
    label: str = ""


class Words(NamedTuple):
    """A text whose upper left corner, or its middle, stands at a place of the panel, 0 to 1."""

    text: str
    x: float = 0.01
    y: float = 0.93
    is_centred: bool = False


class Heat(NamedTuple):
    """Values (rows of y, columns of x) over the whole panel as colours."""

    x: Floats
    y: Floats
    values: Floats


@dataclass
class Panel:
    """One pair of axes. Those with the same ``span`` of x zoom together.

    Without an ``xlabel`` or a ``ylabel`` that axis has no numbers, and without a ``span`` there
    are no axes. ``names`` is how many names its legend has in a row; 0 is no legend.
    """

    span: Span | None
    xlabel: str = ""
    ylabel: str = ""
    title: str = ""
    low: float | None = None
    high: float | None = None
    is_log: bool = False
    names: int = 0
    curves: list[Curve] = field(default_factory=list)
    areas: list[Area] = field(default_factory=list)
    bands: list[Band] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    words: list[Words] = field(default_factory=list)
    heat: Heat | None = None


@dataclass
class Figure:
    """Rows of panels; one alone in its row takes all columns.

    A page of one that ``is_over_log`` shows which options replay the seconds that are seen.
    """

    title: str
    rows: list[list[Panel]]
    inches: tuple[float, float]
    heights: list[float] | None = None
    widths: list[float] | None = None
    is_over_log: bool = False

    @property
    def columns(self) -> int:
        """How many panels the longest row has."""
        return max(map(len, self.rows))
