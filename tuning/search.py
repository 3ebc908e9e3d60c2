"""One search: it sends out batches of candidates, takes in their costs and remembers the best.

An algorithm calls :meth:`Search.costs`, as often as it likes, and never sees who computes. What it
asks depends on its seed and on the costs only. So the record of the costs is the whole state of a
search: fed the recorded costs again, the algorithm asks the same questions, and goes on where it
was. That makes one checkpoint serve every algorithm, those of other libraries, too.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from drivers.output_file import written_for
from estimator.errors import InputError
from estimator.types import Floats
from tuning.space import Space, decode, make_feasible

SCHEMA = 3  # of a checkpoint


class SearchOptions(NamedTuple):
    """What determines the questions a search asks, besides the costs.

    ``food_sources`` and ``cycles`` set the budget of every algorithm; only the bee colony uses
    ``limit``.
    """

    algorithm: str
    food_sources: int
    cycles: int
    limit: int
    seed: int

    @property
    def budget(self) -> int:
        """Evaluations, not counting scouts."""
        return self.food_sources * (1 + 2 * self.cycles)


class Progress(NamedTuple):
    """Where a search stands after a cycle. Mean and median are over the population."""

    evaluations: int
    cycles: int
    best_cost: float
    mean_cost: float
    median_cost: float


class Record(NamedTuple):
    """All costs so far (E,) and a SHA-256 of all candidates: enough to resume a search."""

    costs: Floats
    asked_sha256: str


class SearchEnd(Exception):  # noqa: N818 - an outcome, not an error
    """Raised out of an algorithm that asks for more than its budget, or is asked to stop."""

    def __init__(self, *, is_finished: bool) -> None:
        self.is_finished = is_finished


@dataclass(eq=False)
class Search:
    """The evaluations of one run, with their record.

    ``evaluate`` maps parameter values (C, D) to costs (C,). ``observe`` is called after each batch
    that is not in ``earlier``, the record of an interrupted run, and returns whether to go on.
    """

    space: Space
    options: SearchOptions
    evaluate: Callable[[Floats], Floats]
    observe: Callable[["Search"], bool] = lambda _: True
    earlier: Record | None = None

    def __post_init__(self) -> None:
        self._known: list[Floats] = []
        self._asked = hashlib.sha256()
        self.evaluations, self.left = 0, self.options.budget  # the latter without scouts
        self.best_cost = np.inf
        self.best_values = np.full(len(self.space), np.nan)
        self.history: list[Progress] = []

    @property
    def cycles(self) -> int:
        """Cycles (generations) so far."""
        return len(self.history)

    @property
    def record(self) -> Record:
        """What a checkpoint has to hold."""
        costs = np.concatenate([np.empty(0), *self._known])
        return Record(costs, self._asked.hexdigest())

    def costs(self, positions: Floats, *, scouts: bool = False) -> Floats:
        """Costs (C,) of positions (C, D) in search coordinates, made feasible first.

        Raises:
            SearchEnd: the budget is used up (scouts do not count), or the observer asked to stop.
            InputError: the record is not of this search.
        """
        if not scouts:
            if self.left == 0 or self.left < len(positions):
                raise SearchEnd(is_finished=True)
            self.left -= len(positions)
        values = decode(self.space, make_feasible(self.space, positions))
        recorded = self._recorded_costs(len(values))
        self._asked.update(np.ascontiguousarray(values).tobytes())
        costs = self.evaluate(values) if recorded is None else recorded
        self._known.append(np.array(costs))
        self.evaluations += len(costs)
        best = int(np.argmin(costs))
        if costs[best] < self.best_cost:
            self.best_cost, self.best_values = float(costs[best]), values[best].copy()
        if recorded is None and not self.observe(self):
            raise SearchEnd(is_finished=False)
        return costs

    def end_cycle(self, costs: Floats) -> None:
        """Note the end of a cycle (generation), and the costs (N,) of its population."""
        of_all = float(np.mean(costs)), float(np.median(costs))
        self.history.append(Progress(self.evaluations, self.cycles + 1, self.best_cost, *of_all))

    def _recorded_costs(self, count: int) -> Floats | None:
        """The next ``count`` recorded costs, or None where the record has ended."""
        if self.earlier is None:
            return None
        costs, asked_sha256 = self.earlier
        left = len(costs) - self.evaluations
        if count > left > 0 or (left == 0 and self._asked.hexdigest() != asked_sha256):
            raise InputError("the checkpoint does not belong to this search")
        if left == 0:
            self.earlier = None
            return None
        return costs[self.evaluations : self.evaluations + count]


class Header(msgspec.Struct):
    """A checkpoint's first line, JSON; costs as little-endian doubles follow."""

    schema: int
    identity: Any
    evaluations: int
    asked_sha256: str


def checkpoint_path(output: Path) -> Path:
    """FILE.checkpoint."""
    return Path(f"{output}.checkpoint")


def write_checkpoint(path: Path, identity: Any, record: Record) -> None:
    """Save the record of the search that ``identity``, which JSON can hold, determines.

    Raises:
        InputError: the file cannot be written.
        NotWholeError: the disk is full, or fails.
    """
    header = Header(SCHEMA, identity, len(record.costs), record.asked_sha256)
    line = msgspec.json.encode(header, order="sorted")
    with written_for("--output", path) as fresh:
        fresh.write_bytes(line + b"\n" + record.costs.astype("<f8").tobytes())


def read_checkpoint(path: Path, identity: Any) -> Record:
    """The record of the search that ``identity`` determines, as far as it came.

    Raises:
        InputError: no such file, not a checkpoint, or one of another search.
    """
    try:
        # nor is a pipe waited for
        content = path.read_bytes() if path.is_file() or not path.exists() else b""
    except FileNotFoundError:
        raise InputError(f"--resume: {path}: no such file; nothing to resume") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    line, _, costs = content.partition(b"\n")
    try:
        header = msgspec.json.decode(line, type=Header)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not a checkpoint") from None
    if header.schema != SCHEMA or len(costs) != 8 * header.evaluations:
        raise InputError(f"{path}: damaged, or of another version")
    different = _differences(msgspec.to_builtins(identity), header.identity)
    if different:
        raise InputError(f"--resume: {path} is of other options: {', '.join(different)}")
    return Record(np.frombuffer(costs, "<f8"), header.asked_sha256)


def _differences(wanted: Any, saved: Any, name: str = "") -> list[str]:
    """Dotted names of what is not equal."""
    if wanted == saved:
        return []
    if not isinstance(wanted, dict) or not isinstance(saved, dict):
        return [name[1:]]
    keys = sorted({*wanted, *saved})
    return [d for k in keys for d in _differences(wanted.get(k), saved.get(k), f"{name}.{k}")]
