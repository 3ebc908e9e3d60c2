"""A core: in compiled memory from its first step on, a tuple whenever somebody asks for it."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, Concatenate, ParamSpec, TypeVar

import numba
import numpy as np

from estimator.aiding.sources.source import in_types_of
from estimator.aiding.sources.table import source_of
from estimator.aiding.types import NO_REPORT, Report
from estimator.arrays import Floats
from estimator.compilation.compiled import direct
from estimator.live import kernel_handle
from estimator.live.core import Core, in_arrays, in_tuples
from estimator.live.reports import age_s
from estimator.live.rows import Rows, require_writable, rows_of
from estimator.live.settings import Settings

P = ParamSpec("P")
R = TypeVar("R")

_numba_config: Any = numba.config  # numba ships no types
_typeof: Any = numba.typeof
# What puts a core into memory, once there is one, and the steps by their kernels: all cores are of
# one type, and to find that out takes a hundred times as long.
_put_forms: list[Callable[..., Any]] = []
_steps: dict[Any, Callable[..., Any]] = {}


def _step(kernel: "Callable[Concatenate[Any, P], R]") -> "cached_property[Callable[P, R]]":
    """A kernel of :mod:`estimator.live.kernel_handle` as a function of all but its handle."""
    return cached_property(lambda holder: holder.bind(kernel))


def _in_plain_numbers(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel in Python, with numpy's numbers in its results as Python's own."""
    return lambda *arguments: _plain_numbers(kernel(*arguments))


def _plain_numbers(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, tuple):
        return value
    kind, parts = type(value), map(_plain_numbers, value)
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


def _put_form(values: tuple[Any, ...]) -> Callable[..., Any]:
    if not _put_forms:
        _put_forms.append(direct(kernel_handle.kernel_handle, tuple(map(_typeof, values))))
    return _put_forms[0]


class Holder:
    """A core and the steps that change it.

    Compiled code is called without a look at its arguments. It takes plain numbers by their
    values and raises TypeError or ValueError for what has none, so the steps of each sample take
    only those.
    Tuples and arrays are looked at here first: InputError is raised for those that do not fit.
    """

    advance = _step(kernel_handle.advance)
    advance_raw = _step(kernel_handle.advance_raw)
    publish = _step(kernel_handle.publish)
    _contents = _step(kernel_handle.contents)
    _clock = _step(kernel_handle.clock)
    _contradicted_axes = _step(kernel_handle.contradicted_axes)
    _lay = _step(kernel_handle.lay)
    brief = _step(kernel_handle.brief)
    take_report = _step(kernel_handle.take_report)
    take_rate = _step(kernel_handle.take_rate)
    _last_report = _step(kernel_handle.last_report)
    _turning = _step(kernel_handle.turning_of)
    _search = _step(kernel_handle.search)

    def __init__(self, settings: Settings, core: Core) -> None:
        self._params = kernel_handle.params_of(settings)
        self._core = core
        self._inside: Any = None
        self._is_in_python = bool(_numba_config.DISABLE_JIT)
        self._hearing: dict[type, Callable[[Any, float], None]] = {}

    @property
    def core(self) -> Core:
        """The core as it is now."""
        if self._inside is None:
            return self._core
        core: Core = in_tuples(self._contents())
        if not self._is_in_python:
            return core
        # as many rates wait as there are
        as_put: Core = in_types_of(
            self._core._replace(rates=core.rates, reports=core.reports), core
        )
        return as_put

    @property
    def clock(self) -> tuple[int, float]:
        """Time (us) of the last sample, and the interval (s) that samples usually come at."""
        if self._inside is None:
            return self._core.time_us, self._core.usual_s
        return self._clock()

    @property
    def turning(self) -> tuple[int, tuple[bool, bool, bool]]:
        """See :func:`estimator.live.kernel_handle.turning_of`."""
        if self._inside is None:
            return self._core.turning.used, self._core.turning.stands_in
        return self._turning()

    @property
    def contradicted_axes(self) -> tuple[bool, bool, bool]:
        """See :func:`estimator.live.kernel_handle.contradicted_axes`."""
        if self._inside is None:  # no sample has come since it was put here
            return False, False, False
        return self._contradicted_axes()

    @property
    def time_us(self) -> int:
        """Time of the last sample."""
        return self.clock[0]

    @property
    def last_report(self) -> tuple[Report, bool]:
        """See :func:`estimator.live.kernel_handle.last_report`."""
        return self._last_report()

    def lay(self, rows: Rows, published: Floats, report_rows: Floats) -> None:
        """See :func:`estimator.live.kernel_handle.lay`; rows of another layout are copied."""
        rows = rows_of(*rows)
        require_writable(published, len(rows.times_us))
        self._lay(rows, published, report_rows)

    def search(self, report: Report) -> bool:
        """See :func:`estimator.live.kernel_handle.search`."""
        return self._search(in_types_of(NO_REPORT, report))

    def take_other_report(self, report: Any, time_us: int) -> None:
        """Take another source's report that belongs to the last sample, of ``time_us``."""
        kind, source = type(report), source_of(report)
        report = in_types_of(source.blank, report)
        if kind not in self._hearing:
            kernel = kernel_handle.hearing(source.observe)
            self._hearing[kind] = self.bind(kernel, source.blank, 0.0)
        self._hearing[kind](report, age_s(report, time_us))

    def bind(self, kernel: Any, *arguments: Any) -> Any:
        """A step that knows what it works on.

        ``arguments`` are examples of its others; of the kernels in ``arguments_with`` none.
        """
        handle = self._put_inside()
        if self._is_in_python:
            return partial(_in_plain_numbers(kernel), handle)
        if arguments:
            return partial(direct(kernel, tuple(map(_typeof, (handle, *arguments)))), handle)
        step = _steps.get(kernel)
        if step is None:
            types = kernel_handle.arguments_with(_typeof(handle))[kernel]
            step = _steps[kernel] = direct(kernel, types)
        return partial(step, handle)

    def _put_inside(self) -> Any:
        if self._inside is None:
            arrays = in_arrays(self._core)
            values = (self._params, arrays, kernel_handle.Situation(), *kernel_handle.NOTHING_LAID)
            put = kernel_handle.kernel_handle if self._is_in_python else _put_form(values)
            self._inside = put(*values)
        return self._inside
