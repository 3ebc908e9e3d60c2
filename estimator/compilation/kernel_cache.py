"""Keeps one kernel's machine code on disk: numba's own cache under names of ours.

Index and data files are read and written by numba's own classes; only their names are ours.
The names are made at the kernel's first call, when all that it uses has been defined.
"""

# mypy: disable-error-code="no-untyped-call,misc,attr-defined"
# numba ships no types.

import functools
import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from types import FunctionType
from typing import Any

from llvmlite.binding import add_symbol, parse_assembly, parse_bitcode
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    NullCache,
)
from numba.core.runtime import _nrt_python

from estimator.compilation.fingerprint import Fingerprints

NOT_KEPT = "compiled code cannot be kept for the next start"
VERSIONS_KEPT = 4  # of one kernel

_fingerprints = Fingerprints()


class KernelCache(NullCache):
    """The cache of one kernel, set up at its first use.

    A compiled form is looked for in all of the folders, and written to the last. After those it
    is looked for in ``shipped``, where forms for any CPU lie.
    """

    def __init__(
        self, function: FunctionType, folders: tuple[Path, ...], shipped: Path | None = None
    ) -> None:
        self._function = function
        self._folders = folders
        self._shipped = shipped

    @property
    def cache_path(self) -> str:
        """The folder that takes what is compiled."""
        return str(self._folders[-1])

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled form for a signature, or None."""
        loaded = (files.load(signature, target_context) for files in self._files)
        return next((form for form in loaded if form is not None), None)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep it. If the disk is full, the next start has to compile again; this one goes on."""
        if not self._folders:
            return
        files = self._files[len(self._folders) - 1]
        try:
            files.save(signature, data)
        except OSError as error:
            _warn_once(f"{NOT_KEPT}: {error.strerror}")
        else:
            files.forget_older()

    def holds(self, target_context: Any) -> bool:
        """Whether it holds any compiled form for this CPU."""
        return any(files.holds(target_context) for files in self._files)

    @functools.cached_property
    def _files(self) -> "tuple[_KernelFiles, ...]":
        own = [_KernelFiles(self._function, folder) for folder in self._folders]
        if self._shipped is None:
            return tuple(own)
        return *own, _ShippedFiles(self._function, self._shipped)


class _KernelFiles(FunctionCache):
    """numba's cache with the given folder and names."""

    def __init__(self, function: FunctionType, folder: Path) -> None:
        self._name = repr(function)
        self._py_func = function
        self._cache_path = str(folder)
        self._kernel = f"{function.__module__}.{function.__qualname__}".replace("<locals>", "")
        made_of = _fingerprints.of(function)
        self._base = f"{self._kernel}-{made_of}.py{sys.version_info[0]}{sys.version_info[1]}"
        self._base += getattr(sys, "abiflags", "")
        self._index = folder / f"{self._base}.nbi"
        self._impl = _KernelFormat(function)
        self._cache_file = IndexDataCacheFile(self._cache_path, self._base, made_of)
        self.enable()

    def load(self, signature: Any, target_context: Any) -> Any:
        """The compiled form, or None; files that a crash or a bad disk has damaged are removed."""
        _name_helpers()
        try:
            # not load_overload, which first loads all that compiling needs: a second, and 27 MB
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, target_context)
        except Exception:  # noqa: BLE001 - whatever reading damaged data may raise
            with suppress(OSError):
                self._index.unlink()
            return None

    def save(self, signature: Any, data: Any) -> None:
        """Keep it. An index that cannot be read, as another version's, begins anew."""
        try:
            self.save_overload(signature, data)
        except OSError:
            raise
        except Exception:  # noqa: BLE001 - whatever reading damaged data may raise
            self._index.unlink(missing_ok=True)
            self.save_overload(signature, data)

    def holds(self, target_context: Any) -> bool:
        """See :meth:`KernelCache.holds`."""
        cpu = self._made_for(target_context.codegen().magic_tuple())
        try:
            return any(key[1] == cpu for key in self._cache_file._load_index())  # noqa: SLF001
        except Exception:  # noqa: BLE001 - whatever reading damaged data may raise
            return False

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        signature, cpu, made_of = super()._index_key(signature, codegen)
        return signature, self._made_for(cpu), made_of

    @staticmethod
    def _made_for(cpu: tuple[str, str, str]) -> tuple[str, str, str]:
        """Architecture, name and features of the CPU that a form is made for, as keys have them."""
        return cpu

    def forget_older(self) -> None:
        """Remove this kernel's files of other sources but the latest few."""
        try:
            others = [
                entry
                for entry in os.scandir(self._cache_path)
                if entry.name.startswith(f"{self._kernel}-") and entry.name.endswith(".nbi")
            ]
            others.sort(key=lambda entry: entry.stat().st_mtime, reverse=True)
            for entry in others[VERSIONS_KEPT:]:
                for path in Path(self._cache_path).glob(f"{entry.name[:-4]}.*"):
                    path.unlink(missing_ok=True)
        except OSError:
            return


class _ShippedFiles(_KernelFiles):
    """Forms that run on any CPU of the architecture, compiled with ``NUMBA_CPU_NAME=generic``."""

    @staticmethod
    def _made_for(cpu: tuple[str, str, str]) -> tuple[str, str, str]:
        return cpu[0], "generic", ""


class _KernelFormat(CompileResultCacheImpl):
    """Machine code as numba writes it, but numba does not choose the place."""

    def __init__(self, function: FunctionType) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Source(function.__code__.co_filename)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """The compiled form, without what only kernels need that are compiled to call this one.

        LLVM's form of the source takes ten times as much memory as the machine code beside it, and
        reading it longer than all else.
        """
        (name, kind, data), described, *others = payload
        if kind != "object":
            return super().rebuild(target_context, payload)
        code, source = data
        # the names that numba would find in the source, and asks for
        names = {described.llvm_func_name, described.llvm_cpython_wrapper_name}
        target_context.codegen()._engine._defined_symbols |= names  # noqa: SLF001
        library = (name, kind, (code, _no_source()))
        form = super().rebuild(target_context, (library, described, *others))
        form.library._get_module_for_linking = lambda: parse_bitcode(source)  # noqa: SLF001
        return form


class _Source:
    """The place as numba asks for it; numba names the source file in one of its warnings."""

    def __init__(self, file: str) -> None:
        self._py_file = file

    def ensure_cache_path(self) -> None:
        """Do nothing: the folder has been made and checked before."""


@functools.cache
def _name_helpers() -> None:
    """Tell LLVM where numba's runtime is, which machine code calls by name."""
    for name, address in _nrt_python.c_helpers.items():
        add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@functools.cache
def _no_source() -> bytes:
    """A module with nothing in it, as numba asks for one."""
    return bytes(parse_assembly("").as_bitcode())


@functools.cache
def _warn_once(text: str) -> None:
    """Warn once only: numba resets Python's own memory of past warnings."""
    warnings.warn(text, RuntimeWarning, stacklevel=2)
