"""What the benchmark asks of a filter."""

from typing import Protocol

from broad_data import Array, Trial


class Run(Protocol):
    """A filter at work on one trial, row after row."""

    def advance(self, rows: slice) -> Array:
        """Take the rows, in order; estimates from sensor to ENU, w first, (N, 4)."""
        ...

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside by the body rotation q* K q, q being the present estimate."""
        ...


class Filter(Protocol):
    """A filter with its settings."""

    name: str

    def start(self, trial: Trial) -> Run:
        """A fresh run at the trial's rate."""
        ...

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample from Python, to be timed."""
        ...
