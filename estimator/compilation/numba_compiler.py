"""numba's compiler, made to do its work once.

numba makes machine code of each function that another one calls, then inlines
it and makes machine code of the whole again, level by level. And at each use of
a tuple it looks into every one of its numbers for memory to count references
of. Here a part is only translated to LLVM's language; it is optimised and made
machine code of where it ends up. A whole step compiles in half the time.

It is built as numba's manual shows it, with pipelines of our own ("Customizing
the compiler"), from classes that numba 0.60 to 0.68 have in common.
"""

# mypy: disable-error-code="no-untyped-call"
# ruff: noqa: SLF001
# numba ships no types, and a pipeline of one's own overrides what it calls private.

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import lowering
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.context import NRTContext
from numba.core.typed_passes import BaseNativeLowering, NativeLowering


class Kernel(CPUDispatcher):
    """A compiled function, called from Python. In others it is a part, which it must also be."""

    @property
    def _numba_type_(self) -> Any:
        """What numba takes it for inside another function."""
        return self.typingctx.resolve_value_type(self.py_func)


class PartLibrary(JITCodeLibrary):
    """The translation of one function, for the kernels that it becomes a part of."""

    def add_llvm_module(self, ll_module: Any) -> None:
        """Keep it as it is."""
        self._final_module.link_in(ll_module)

    def add_linking_library(self, library: Any) -> None:
        """Remember it for the kernels."""
        self._linking_libraries.append(library)

    def finalize(self) -> None:
        """No machine code."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                function.linkage = "linkonce_odr"  # may come twice: one is kept
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """This function with all that it calls."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in self._called({}):
                is_part = isinstance(library, PartLibrary)
                module = library._final_module if is_part else library._get_module_for_linking()
                self._shared_module.link_in(module, preserve=True)
        return self._shared_module

    def _called(self, found: dict[Any, None]) -> dict[Any, None]:
        """Everything that it calls, at any depth, each once."""
        for library in self._linking_libraries:
            if library not in found:
                found[library] = None
                library._ensure_finalized()
                if isinstance(library, PartLibrary):
                    library._called(found)
        return found


class LeanReferences(NRTContext):
    """Counts references without a look at values that have none."""

    def __init__(self, context: Any) -> None:
        super().__init__(context, context.enable_nrt)
        self._counts: dict[Any, bool] = {}

    def get_meminfos(self, builder: Any, ty: Any, val: Any) -> Any:
        """The counted memory in a value."""
        if ty not in self._counts:
            self._counts[ty] = self._context.data_model_manager[ty].contains_nrt_meminfo()
        return super().get_meminfos(builder, ty, val) if self._counts[ty] else []


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(NativeLowering):
    """Makes a kernel."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        """numba's pass."""
        state.targetctx.nrt = LeanReferences(state.targetctx)
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(BaseNativeLowering):
    """Makes a part."""

    _name = "part_lowering"  # type: ignore[assignment]
    lowering_class = lowering.Lower

    def run_pass(self, state: Any) -> bool:
        """numba's pass with our library, and without what needs machine code."""
        context = state.targetctx
        context.nrt = LeanReferences(context)
        library = PartLibrary(context.codegen(), state.func_id.func_qualname)
        state.library = library
        state.flags.no_compile = True
        super().run_pass(state)
        result = state["cr"]
        module, name = result.fndesc.lookup_module(), result.fndesc.qualname
        # what numba knows the part by; it cannot be called
        handle = _dynfunc.make_function(module, name, "", 0, result.env, (library,))
        context.insert_user_function(handle, result.fndesc, [library])
        state["cr"] = result._replace(cfunc=handle)
        return True


class KernelCompiler(CompilerBase):
    """numba's pipeline with another last step."""

    lowering: type = KernelLowering

    def define_pipelines(self) -> list[Any]:
        """The one pipeline: there is no object mode."""
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [
            (self.lowering if kind is NativeLowering else kind, text)
            for kind, text in pipeline.passes
        ]
        pipeline.finalize()
        return [pipeline]


class PartCompiler(KernelCompiler):
    """Likewise for a part."""

    lowering = PartLowering
