"""A core: in compiled memory from its first step on, a value on demand."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from estimator.aiding.sources.source import in_types_of, source_of
from estimator.aiding.types import NO_REPORT, Report
from estimator.arrays import Floats
from estimator.compilation.compiled import entry_point, is_compiled_code
from estimator.live import kernel_handle
from estimator.live.core import Core, in_arrays
from estimator.live.rows import Rows, require_writable, rows_of
from estimator.live.settings import Settings
from estimator.live.situation import Situation

P = ParamSpec("P")
R = TypeVar("R")


def _step(kernel: "Callable[Concatenate[Any, P], R]") -> "cached_property[Callable[P, R]]":
    """A kernel of :mod:`estimator.live.kernel_handle` as a function of all but its handle."""
    return cached_property(lambda holder: holder.bind(entry_point(kernel)))


def _plain_numbers(value: Any) -> Any:
    """A result of plain Python with numpy's numbers as Python's own."""
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, tuple):
        return value
    kind, parts = type(value), map(_plain_numbers, value)
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


class Holder:
    """A core and the steps that change it.

    Compiled code does not check its arguments: it takes plain numbers by their values and raises
    TypeError or ValueError for anything else, so the steps of each sample take only numbers. Tuples
    and arrays are checked here first: one that does not fit raises InputError.
    """

    advance = _step(kernel_handle.advance)
    publish = _step(kernel_handle.publish)
    set_situation = _step(kernel_handle.set_situation)
    take_report = _step(kernel_handle.take_report)
    _contents = _step(kernel_handle.contents)
    status = _step(kernel_handle.status)
    _bind_rows = _step(kernel_handle.bind_rows)
    last_report = _step(kernel_handle.last_report)
    _search = _step(kernel_handle.search)

    def __init__(self, settings: Settings, core: Core) -> None:
        self._settings = settings
        self._core = core

    @property
    def core(self) -> Core:
        """The core as it is now; its arrays are nobody's to change."""
        return self._contents() if "_handle" in self.__dict__ else self._core

    @property
    def time_us(self) -> int:
        """Time of the last sample."""
        return self.status()[0]

    def bind_rows(self, rows: Rows, published: Floats, report_rows: Floats) -> None:
        """See :func:`estimator.live.kernel_handle.bind_rows`; other layouts are copied."""
        rows = rows_of(*rows)
        require_writable(published, len(rows.times_us))
        self._bind_rows(rows, published, report_rows)

    def search(self, report: Report) -> bool:
        """See :func:`estimator.live.kernel_handle.search`."""
        return self._search(in_types_of(NO_REPORT, report))

    def take_other_report(self, report: Any, ago_s: float) -> None:
        """Take another source's report, of ``ago_s`` before the last sample."""
        source = source_of(report)
        report = in_types_of(source.blank, report)
        self.bind(kernel_handle.late_report_step(source))(report, ago_s)

    def bind(self, step: Callable[..., Any]) -> Any:
        """A step that knows what it works on."""
        if is_compiled_code():
            return partial(step, self._handle)
        return lambda *arguments: _plain_numbers(step(self._handle, *arguments))

    @cached_property
    def _handle(self) -> Any:
        """The handle on the core, which is put into compiled memory when it is first needed."""
        put = entry_point(kernel_handle.new_handle)
        own = in_arrays(self._core)  # steps write into them
        return put(self._settings, own, Situation(), *kernel_handle.NO_ROWS_BOUND)
