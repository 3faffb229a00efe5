"""How numba is led to compile a kernel: with what kernels need of its passes, and to machine code only once.

Numba's own compiler is made for any function. Kernels have no closures, comprehensions or exceptions, but records of
dozens of arrays, and call each other many levels deep, so that numba would optimise the lowest of them, and write
machine code for it, once for every level.
"""

import copy
import operator
from collections import Counter
from typing import Any

import llvmlite.binding as llvm
from numba.core import cgutils, ir, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.ir_utils import replace_vars
from numba.core.lowering import Lower
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.types.containers import BaseNamedTuple
from numba.core.typing.context import Context
from numba.core.untyped_passes import (
    DeadBranchPrune,
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    RewriteSemanticConstants,
    TranslateByteCode,
)

Field = tuple[str, str]


@register_pass(mutates_CFG=False, analysis_only=False)
class TakeRecordsApart(FunctionPass):  # type: ignore[misc]
    """Read the fields of records among the arguments once, at the start.

    Whoever reads a field has the compiler load the whole record first, 189 numbers for a block of paths, and count
    references to all of its arrays.
    """

    _name = "take_records_apart"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """See `FunctionPass`: whether the function has changed."""
        blocks = state.func_ir.blocks
        times = Counter(one.target.name for block in blocks.values() for one in block.find_insts(ir.Assign))
        first = blocks[min(blocks)]
        arguments = [one for one in first.find_insts(ir.Assign) if isinstance(one.value, ir.Arg)]
        records = {
            one.target.name: (one.target, state.args[one.value.index])
            for one in arguments
            if times[one.target.name] == 1 and isinstance(state.args[one.value.index], BaseNamedTuple)
        }
        fields: dict[str, ir.Assign] = {}
        instead: dict[str, ir.Var] = {}
        for label in sorted(blocks) if records else ():
            for one in list(blocks[label].find_insts(ir.Assign)):
                if times[one.target.name] > 1:
                    continue
                if isinstance(one.value, ir.Var) and one.value.name in records:  # another name for it
                    records[one.target.name] = records[one.value.name]
                elif isinstance(one.value, ir.Expr) and one.value.op == "getattr" and one.value.value.name in records:
                    record, kind = records[one.value.value.name]
                    if one.value.attr not in kind.fields:
                        continue
                    name = f"${record.name}.{one.value.attr}"
                    if name not in fields:
                        taken = ir.Expr.getattr(record, one.value.attr, one.loc)
                        fields[name] = ir.Assign(taken, ir.Var(one.target.scope, name, one.loc), one.loc)
                    field = instead[one.target.name] = fields[name].target
                    inner = kind.types[kind.fields.index(one.value.attr)]
                    if isinstance(inner, BaseNamedTuple):
                        records[name] = records[one.target.name] = (field, inner)
                    blocks[label].remove(one)
        replace_vars(blocks, instead)
        start = max((first.body.index(one) for one in arguments), default=-1) + 1
        first.body[start:start] = fields.values()
        return bool(fields)


BORROWING = {"getattr", "getitem", "static_getitem", "build_tuple", "exhaust_iter", "getiter", "iternext", "pair_first",
             "pair_second", "cast", "phi"}  # fmt: skip
"""What gives arrays that others hold."""


@register_pass(mutates_CFG=False, analysis_only=True)
class BorrowArrays(FunctionPass):  # type: ignore[misc]
    """Count no references to arrays in a kernel that makes none and gives none back: its caller holds them all."""

    _name = "borrow_arrays"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """See `FunctionPass`: whether the function has changed."""

        def counted(kind: Any) -> bool:
            return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())

        def borrows(one: Any) -> bool:
            if not isinstance(one.value, ir.Expr) or one.value.op in BORROWING:
                return True
            packs = one.value.op == "call" and isinstance(state.typemap[one.value.func.name], types.NamedTupleClass)
            return packs or not counted(state.typemap[one.target.name])

        assigned = (one for block in state.func_ir.blocks.values() for one in block.find_insts(ir.Assign))
        if not counted(state.return_type) and all(map(borrows, assigned)):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return False


class _Remembering(Context):  # type: ignore[misc]
    """Numba's knowledge of types, which remembers what it has found for functions that are not kernels.

    To find what a product of two numbers is, numba goes through all that it knows to multiply, every time.
    """

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        if not isinstance(func, types.Function):
            return super().resolve_function_type(func, args, kws)
        key = func, tuple(args), tuple(sorted(kws.items()))
        if key not in _found:
            _found[key] = super().resolve_function_type(func, args, kws)
        return _found[key]


_found: dict[Any, Any] = {}


class _Lower(Lower):  # type: ignore[misc]
    """From operations of known types to LLVM's."""

    def lower_binop(self, resty: Any, expr: Any, op: Any) -> Any:
        """Operate on two numbers as is remembered; numba would look for that anew, three times."""
        if op in (operator.pow, operator.ipow):  # which it has for constant exponents
            return super().lower_binop(resty, expr, op)
        signature = self.fndesc.calltypes[expr]
        sides = [
            self.context.cast(self.builder, self.loadvar(side.name), self.typeof(side.name), wanted)
            for side, wanted in zip((expr.lhs, expr.rhs), signature.args, strict=True)
        ]
        knowledge = self.context.typing_context
        kind = knowledge.resolve_value_type(op)
        signature = knowledge.resolve_function_type(kind, signature.args, {})
        result = self.context.get_function(kind, signature)(self.builder, sides)
        return self.context.cast(self.builder, result, signature.return_type, resty)

    def alloca_lltype(self, name: str, lltype: Any, datamodel: Any = None) -> Any:  # noqa: ARG002, numba's own
        """Room for a variable; numba has LLVM measure it, too, for debuggers."""
        return cgutils.alloca_once(self.builder, lltype, name=name, zfill=False)


@register_pass(mutates_CFG=True, analysis_only=False)
class Lowering(NativeLowering):  # type: ignore[misc]
    """From numba's code to LLVM's."""

    _name = "kernel_lowering"

    @property
    def lowering_class(self) -> type[Lower]:
        """See `NativeLowering`."""
        return _Lower


class ForPython(CompilerBase):  # type: ignore[misc]
    """Compiler of kernels as Python calls them."""

    def define_pipelines(self) -> list[PassManager]:
        """See `CompilerBase`: its passes."""
        self.state.typingctx = copy.copy(self.state.typingctx)
        self.state.typingctx.__class__ = _Remembering
        self.state.targetctx = self.state.targetctx.subtarget(typing_context=self.state.typingctx)
        passes = PassManager("kernel")
        for one in (
            TranslateByteCode,
            FixupArgs,
            IRProcessing,
            RewriteSemanticConstants,
            DeadBranchPrune,
            GenericRewrites,
            TakeRecordsApart,
            ReconstructSSA,
            NopythonTypeInference,
            PreLowerStripPhis,
            BorrowArrays,
            IRLegalization,
            Lowering,
            NoPythonBackend,
        ):
            passes.add_pass(one, one.__name__)
        passes.finalize()
        return [passes]


class ForKernels(ForPython):
    """Compiler of kernels as other kernels call them."""

    def define_pipelines(self) -> list[PassManager]:
        """See `CompilerBase`: its passes."""
        self.state.library = _Unfinished(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class _Unfinished(JITCodeLibrary):  # type: ignore[misc]
    """Code that is optimised, and becomes machine code, in the kernel for Python that it ends up in."""

    _final_module: Any

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)  # noqa: SLF001 - numba has no public way
        self._final_module.verify()
        self._finalized = True
        self._shared_module = self._get_module_for_linking()
        # Numba looks for the addresses of these, one for each function.
        names = [one for one in self._final_module.global_variables if one.name.startswith("_ZN08NumbaEnv")]
        self._final_module = llvm.parse_assembly("\n".join(map(str, names)))
        self._finalize_final_module()
