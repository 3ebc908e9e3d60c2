"""A core: in compiled memory from its first step on, a tuple whenever somebody asks for it."""

from functools import cached_property, partial
from typing import Any

import numba

from estimator.compilation.direct import direct
from estimator.live import resident
from estimator.live.core import Core, flat
from estimator.live.settings import Settings

_numba_config: Any = numba.config  # numba ships no types
_typeof: Any = numba.typeof


def _step(kernel: Any) -> Any:
    """A kernel of :mod:`estimator.live.resident` as a function of all but its handle."""
    return cached_property(lambda holder: holder.bind(kernel))


class Holder:
    """A core and the steps that change it."""

    advance = _step(resident.advance)
    lay = _step(resident.lay)
    advance_raw = _step(resident.advance_raw)
    advance_aided = _step(resident.advance_aided)
    see_between = _step(resident.see_between)
    hear = _step(resident.hear)
    search = _step(resident.search)
    publish = _step(resident.publish)

    def __init__(self, settings: Settings, core: Core) -> None:
        self._params = resident.params_of(settings)
        self._core = core
        self._inside: Any = None

    @property
    def core(self) -> Core:
        """The core as it is now."""
        if self._inside is None:
            return self._core
        core: Core = resident.contents(self._inside)
        return core._replace(covariance=flat(core.covariance), trail=flat(core.trail))

    def bind(self, kernel: Any) -> Any:
        """A step that knows what it works on."""
        if self._inside is None:
            self._inside = resident.resident(
                self._params, resident.in_arrays(self._core), *resident.NOTHING_LAID
            )
        if _numba_config.DISABLE_JIT:
            return partial(kernel, self._inside)
        types = resident.arguments_with(_typeof(self._inside))[kernel]
        return partial(direct(kernel, types), self._inside)
