"""Type checks of counting builds: arithmetic must be on numbers, and subscripts must be elements."""

from __future__ import annotations

from typing import Any

import numba.core.types
from numba.core import compiler, compiler_machinery, ir, typed_passes
from numba.extending import intrinsic

from codecbench.core.counting.expressions import UncountableError
from codecbench.core.counting.operations import ALLOCATIONS, FILLED_ALLOCATIONS

types: Any = numba.core.types  # numba is typed in part, and differently in each version
_machinery: Any = compiler_machinery
_compiler: Any = compiler


@intrinsic
def count_and_return(typing_context: Any, counters: Any, times: Any, value: Any) -> Any:
    """Return `value`, and add `times` to `counters`, element by element, at each evaluation."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        for position in range(len(times)):
            counter = builder.gep(array.data, [context.get_constant(types.intp, position)])
            amount = builder.extract_value(arguments[1], position)
            builder.store(builder.add(builder.load(counter), amount), counter)
        if context.enable_nrt:
            context.nrt.incref(builder, signature.return_type, arguments[2])
        return arguments[2]

    return value(counters, types.UniTuple(types.int64, len(times)), value), generate


_ALLOCATIONS = {allocation.__name__ for allocation in (*ALLOCATIONS, *FILLED_ALLOCATIONS)}
_VIEWS = (types.SliceType, types.EllipsisType, types.NoneType)


def _is_number(numba_type: Any) -> bool:
    return isinstance(types.unliteral(numba_type), types.Number | types.Boolean)


def _parts(index: Any) -> tuple[Any, ...]:
    return tuple(index) if isinstance(index, types.BaseTuple) else (index,)


class _Checker:
    """Checks the statements of one function after type inference."""

    def __init__(self, state: Any) -> None:
        self._ir, self._types = state.func_ir, state.typemap

    def _fail(self, statement: Any, what: str, instead: str) -> None:
        name = self._ir.func_id.func_qualname.removesuffix("__counting")
        raise UncountableError(
            f"{statement.loc.filename}:{statement.loc.line}: kernel {name} {what}, which cannot be counted; {instead}"
        )

    def _type(self, variable: Any) -> Any:
        return self._types[variable.name]

    def _origin(self, variable: Any) -> Any:
        return getattr(self._ir.get_definition(variable), "op", None)

    def check(self, statement: Any) -> None:
        if isinstance(statement, ir.SetItem | ir.StaticSetItem):
            self._check_store(statement)
        elif isinstance(statement, ir.Assign) and isinstance(statement.value, ir.Expr):
            self._check_expression(statement, statement.value)

    def _check_expression(self, statement: Any, expression: Any) -> None:
        if expression.op in ("binop", "inplace_binop", "unary"):
            if not all(_is_number(self._type(operand)) for operand in expression.list_vars()):
                self._fail(statement, "does arithmetic on whole arrays", "write a loop over the elements")
        elif expression.op in ("getitem", "static_getitem"):
            self._check_load(statement, expression)
        elif expression.op == "call":
            self._check_call(statement, expression)

    def _check_load(self, statement: Any, expression: Any) -> None:
        owner, result = self._type(expression.value), self._type(statement.target)
        if not isinstance(owner, types.Array):
            if self._origin(expression.value) not in ("exhaust_iter", "getattr"):
                self._fail(
                    statement, "indexes a value other than an array", "unpack a tuple into names, pass tables as arrays"
                )
            return
        index = expression.index if expression.op == "getitem" else expression.index_var
        is_view = index is not None and any(isinstance(part, _VIEWS) for part in _parts(self._type(index)))
        if not is_view and not _is_number(result):
            self._fail(statement, "indexes a row with one index too few", "write a[i, :] or a[i, j]")

    def _check_store(self, statement: Any) -> None:
        owner, value = self._type(statement.target), self._type(statement.value)
        index = statement.index_var if isinstance(statement, ir.StaticSetItem) else statement.index
        parts = _parts(self._type(index))
        is_view = any(isinstance(part, _VIEWS) for part in parts)
        if not _is_number(value) or not (is_view or len(parts) == getattr(owner, "ndim", -1)):
            self._fail(statement, "stores a whole array or row at once", "write a loop over the elements")

    def _check_call(self, statement: Any, expression: Any) -> None:
        callee_type = self._type(expression.func)
        definition = self._ir.get_definition(expression.func)
        callee = getattr(definition, "value", None)
        is_kernel = isinstance(callee_type, types.Dispatcher | types.RecursiveCall)
        if is_kernel or callee is count_and_return or callee is len:
            return
        if getattr(definition, "attr", getattr(callee, "__name__", "")) in _ALLOCATIONS:
            return
        if any(isinstance(self._type(argument), types.Array) for argument in expression.args):
            self._fail(statement, "calls a function of whole arrays", "write a loop over the elements")


@_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _CheckTypes(_machinery.AnalysisPass):  # type: ignore[misc]
    _name = "codecbench_check_types"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        checker = _Checker(state)
        for block in state.func_ir.blocks.values():
            for statement in block.body:
                checker.check(statement)
        return False


class CountingCompiler(_compiler.CompilerBase):  # type: ignore[misc]
    """numba's compiler, which refuses what the counters would miss."""

    def define_pipelines(self) -> list[Any]:
        manager = _compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.add_pass_after(_CheckTypes, typed_passes.NopythonTypeInference)
        manager.finalize()
        return [manager]
