"""Machine code of kernels, linked from that of their parts and optimised once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment
from numba.core.typed_passes import NativeLowering

_WIDEST = '"prefer-vector-width"="512"'


class _WideLibrary(JITCodeLibrary):
    """Code that uses the widest vectors: LLVM prefers 256 bits on processors of Intel's that have 512."""

    def add_ir_module(self, ir_module: Any) -> None:
        for function in ir_module.functions:
            if not function.is_declaration:
                set.add(function.attributes, _WIDEST)  # not among those that llvmlite knows
        super().add_ir_module(ir_module)


class _PartLibrary(_WideLibrary):
    """Code of a part, neither linked nor optimised."""

    def finalize(self) -> None:
        self._finalized = True


class Elsewhere(_PartLibrary):
    """Code of a shared kernel, which is not linked, but must be there before code that calls it is."""

    def __init__(self, codegen: Any, name: str, require: Callable[[], object]) -> None:
        super().__init__(codegen, name)
        self.require = require

    def _get_module_for_linking(self) -> Any:
        raise TypeError("a kernel that is `shared` is called by those of beltarm_env.jit, not by others of numba's")


class _WholeLibrary(_WideLibrary):
    """Code of a kernel, linked from its parts."""

    required: tuple[Callable[[], object], ...] = ()
    """What loads the shared kernels that it calls."""

    def finalize(self) -> None:
        found: dict[Any, None] = {}
        _collect(self._linking_libraries, found)
        elsewhere = [library for library in found if isinstance(library, Elsewhere)]
        self.required = tuple(library.require for library in elsewhere)
        for library in elsewhere:
            del found[library]
        # Callers first: LLVM leaves out what nothing calls yet.
        self._linking_libraries = list(found)[::-1]
        super().finalize()


def _collect(libraries: Iterable[Any], found: dict[Any, None]) -> None:
    """Note these libraries and all that they call, each behind what it calls."""
    for library in libraries:
        if library not in found:
            if isinstance(library, _PartLibrary):
                _collect(library._linking_libraries, found)
            found[library] = None


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "beltarm_part_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        entry = object()  # numba finds a function by what would call its machine code
        state.targetctx.insert_user_function(entry, state["cr"].fndesc, [state.library])
        state["cr"] = state["cr"]._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _WholeLowering(NativeLowering):
    _name = "beltarm_whole_lowering"

    def run_pass(self, state: Any) -> Literal[True]:
        code = state.targetctx.codegen()
        state.library = _WholeLibrary(code, state.func_id.func_qualname)
        state.library.enable_object_caching()
        super().run_pass(state)
        state.reload_init.extend(state.library.required)  # which numba calls as it loads this code
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)  # what a part needs to raise
            if environment is not None:
                code.set_env(variable.name, environment)
        return True


class PartCompiler(CompilerBase):
    """Compiler of a part: numba's own, up to the translation for LLVM."""

    lowering: Any = _PartLowering

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes, with the last one replaced."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(self.lowering if step is NativeLowering else step, text) for step, text in passes.passes]
        passes.finalize()
        return [passes]


class WholeCompiler(PartCompiler):
    """Compiler of a kernel with all its parts."""

    lowering = _WholeLowering
