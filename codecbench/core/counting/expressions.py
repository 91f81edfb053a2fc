"""Rewriting of expressions for a counting build, to count what is evaluated only on some paths."""

from __future__ import annotations

import ast
from collections import Counter
from types import FunctionType
from typing import Any, TypeAlias, TypeGuard

from codecbench.core.counting.operations import (
    ALLOCATIONS,
    COUNTERS,
    FILLED_ALLOCATIONS,
    FUNCTIONS,
    OPERATORS,
    SELECTIONS,
    is_conversion,
    is_literal,
)
from codecbench.core.kernels.source import resolve

PREFIX = "counting__"
"""Prefix of all names that the rewriting adds."""

COUNTED = PREFIX + "counted"
ARRAY = PREFIX + "counters"
_UNINDEXED = ("reads", "writes", "index_ops")

Tally: TypeAlias = Counter[str]
"""Increment of each counter for one evaluation."""


class UncountableError(TypeError):
    """A kernel does something that cannot be counted exactly; the message names the line and what to write instead."""


def load(name: str) -> ast.Name:
    """Create the node that loads a name."""
    return ast.Name(name, ast.Load())


def takes_view(node: ast.Subscript) -> bool:
    """Return whether a subscript selects part of an array, by a slice, rather than an element."""
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    return any(isinstance(part, ast.Slice) or (isinstance(part, ast.Constant) and part.value is ...) for part in parts)


def add_count(node: ast.expr, tally: Tally) -> ast.expr:
    """Return `node`, changed to add `tally` to the counters at each evaluation."""
    if not tally:
        return node
    if (part := _certain_part(node)) is not None:
        owner, field, position = part
        child = getattr(owner, field)
        if position is None:
            setattr(owner, field, add_count(child, tally))
        else:
            child[position] = add_count(child[position], tally)
        return node
    times: list[ast.expr] = [ast.Constant(tally[name]) for name in COUNTERS]
    return ast.Call(load(COUNTED), [load(ARRAY), ast.Tuple(times, ast.Load()), node], [])


def _certain_part(node: ast.expr) -> tuple[ast.expr, str, int | None] | None:
    """Return the place of a part of `node` that is always evaluated; None if `node` does not branch.

    numba loses a function whose arguments branch, so the counting call must wrap a part without branches.
    """
    if not any(_branches(part) for part in ast.walk(node)):
        return None
    match node:
        case ast.BoolOp():
            return node, "values", 0
        case ast.IfExp():
            return node, "test", None
        case ast.Compare() | ast.BinOp():
            return node, "left", None
        case ast.UnaryOp():
            return node, "operand", None
        case ast.Subscript():
            return node, "slice", None
        case ast.Tuple():
            return node, "elts", 0
        case ast.Call():
            return node, "args", len(node.args) - 1
    raise AssertionError(ast.dump(node))


def _branches(node: ast.AST) -> bool:
    return isinstance(node, ast.BoolOp | ast.IfExp) or (isinstance(node, ast.Compare) and len(node.ops) > 1)


class Expressions:
    """Rewrites expressions and tallies the certain cost of evaluating them once.

    `index` is true inside brackets and bounds of ranges, where arithmetic counts as `index_ops`.
    """

    def __init__(self, function: FunctionType) -> None:
        self.function = function
        self.used_counters: set[str] = set()
        self.kernels: dict[str, Any] = {}

    def error(self, node: ast.AST, what: str, instead: str) -> UncountableError:
        """Return the error for a node: what it does, and what to write instead."""
        code = self.function.__code__
        line = getattr(node, "lineno", code.co_firstlineno)
        return UncountableError(
            f"{code.co_filename}:{line}: kernel {self.function.__qualname__} {what}, which cannot be counted; {instead}"
        )

    def add(self, tally: Tally, counters: tuple[str, ...], index: bool = False, times: int = 1) -> None:
        """Add operations to a tally."""
        if index:
            counters = tuple(n if n in _UNINDEXED else "index_ops" for n in counters if n != "divisions")
        for name in counters:
            tally[name] += times
            self.used_counters.add(name)

    def expression(self, node: ast.expr, tally: Tally, index: bool = False) -> ast.expr:
        """Rewrite an expression, and tally its certain cost. Raises UncountableError if it cannot be counted."""
        if is_literal(node):
            return node
        rewrite = getattr(self, f"_{type(node).__name__.lower()}", None)
        if rewrite is None:
            raise self.error(node, f"uses {ast.unparse(node)!r}", "write it with loops, numbers and array elements")
        rewritten: ast.expr = rewrite(node, tally, index)
        return ast.copy_location(rewritten, node)

    def sometimes(self, node: ast.expr, index: bool = False, test: bool = False) -> ast.expr:
        """Rewrite an expression that is evaluated only on some paths, so that it counts itself."""
        tally: Tally = Counter()
        return add_count((self.truth if test else self.expression)(node, tally, index), tally)

    def truth(self, node: ast.expr, tally: Tally, index: bool = False) -> ast.expr:
        """Rewrite a condition; a value that is no comparison is compared with zero."""
        if isinstance(node, ast.BoolOp):
            values = [self.truth(node.values[0], tally, index)]
            values += [self.sometimes(value, index, test=True) for value in node.values[1:]]
            return ast.BoolOp(node.op, values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return ast.UnaryOp(node.op, self.truth(node.operand, tally, index))
        if not isinstance(node, ast.Compare | ast.Constant):
            self.add(tally, ("comparisons",), index)
        return self.expression(node, tally, index)

    def _name(self, node: ast.Name, tally: Tally, index: bool) -> ast.expr:
        if node.id.startswith(PREFIX):
            raise self.error(node, f"uses the name {node.id}", f"names starting with {PREFIX} are reserved")
        return node

    def _constant(self, node: ast.Constant, tally: Tally, index: bool) -> ast.expr:
        if node.value is not None and not (index and node.value is Ellipsis):
            raise self.error(node, f"uses the constant {node.value!r}", "kernels work on numbers and arrays")
        return node

    def _tuple(self, node: ast.Tuple, tally: Tally, index: bool) -> ast.expr:
        return ast.Tuple([self.expression(part, tally, index) for part in node.elts], node.ctx)

    def _slice(self, node: ast.Slice, tally: Tally, index: bool) -> ast.expr:
        parts = (node.lower, node.upper, node.step)
        return ast.Slice(*(part and self.expression(part, tally, True) for part in parts))

    def _binop(self, node: ast.BinOp, tally: Tally, index: bool) -> ast.expr:
        self.add(tally, self._cost(node, node.op), index)
        return ast.BinOp(self.expression(node.left, tally, index), node.op, self.expression(node.right, tally, index))

    def _unaryop(self, node: ast.UnaryOp, tally: Tally, index: bool) -> ast.expr:
        if isinstance(node.op, ast.Not):
            return self.truth(node, tally, index)
        self.add(tally, self._cost(node, node.op), index)
        return ast.UnaryOp(node.op, self.expression(node.operand, tally, index))

    def _compare(self, node: ast.Compare, tally: Tally, index: bool) -> ast.expr:
        left = self.expression(node.left, tally, index)
        self.add(tally, self._cost(node, node.ops[0]), index)
        comparators = [self.expression(node.comparators[0], tally, index)]
        for operator, comparator in zip(node.ops[1:], node.comparators[1:], strict=True):
            later: Tally = Counter()
            self.add(later, self._cost(node, operator), index)
            comparators.append(add_count(self.expression(comparator, later, index), later))
        return ast.Compare(left, node.ops, comparators)

    def _boolop(self, node: ast.BoolOp, tally: Tally, index: bool) -> ast.expr:
        first = self.truth(node.values[0], tally, index)
        between = [self.sometimes(value, index, test=True) for value in node.values[1:-1]]
        return ast.BoolOp(node.op, [first, *between, self.sometimes(node.values[-1], index)])

    def _ifexp(self, node: ast.IfExp, tally: Tally, index: bool) -> ast.expr:
        test = self.truth(node.test, tally, index)
        return ast.IfExp(test, self.sometimes(node.body, index), self.sometimes(node.orelse, index))

    def _attribute(self, node: ast.Attribute, tally: Tally, index: bool) -> ast.expr:
        if isinstance(node.value, ast.Name) and node.attr in ("shape", "size", "ndim", "dtype"):
            return node
        try:
            resolve(node, self.function)
        except (KeyError, AttributeError):
            raise self.error(node, f"uses {ast.unparse(node)!r}", "do it outside and pass the result") from None
        return node

    def _subscript(self, node: ast.Subscript, tally: Tally, index: bool) -> ast.expr:
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            return ast.Subscript(self._attribute(node.value, tally, index), node.slice, node.ctx)
        if not takes_view(node):
            self.add(tally, ("reads",))
        return self.element(node, tally)

    def element(self, node: ast.Subscript, tally: Tally) -> ast.Subscript:
        """Rewrite a subscript as a source or target, and tally the cost of its index."""
        if not isinstance(node.value, ast.Name | ast.Attribute):
            raise self.error(node, f"indexes {ast.unparse(node.value)!r}", "index an array by name, with a[i, j]")
        owner = self.expression(node.value, tally)
        return ast.copy_location(ast.Subscript(owner, self.expression(node.slice, tally, True), node.ctx), node)

    def _call(self, node: ast.Call, tally: Tally, index: bool) -> ast.expr:
        name = ast.unparse(node.func)
        try:
            callee = resolve(node.func, self.function)
        except (KeyError, AttributeError):
            raise self.error(node, f"calls {name!r}", "call kernels and functions by global names") from None
        if hasattr(type(callee), "counting_build"):
            return self._kernel_call(node, callee, tally, index)
        if callee in FILLED_ALLOCATIONS:
            raise self.error(node, f"uses {name!r} inside a statement", "give the new array a name first")
        if callee in ALLOCATIONS:
            return self.arguments(node, tally, True)
        if callee in SELECTIONS and len(node.args) > 1:
            self.add(tally, ("comparisons",), index, len(node.args) - 1)
        elif callee in FUNCTIONS:
            self.add(tally, FUNCTIONS[callee], index)
        elif not is_conversion(callee):
            raise self.error(node, f"calls {name!r}", "call a @kernel, or a function listed in the documentation")
        return self.arguments(node, tally, index)

    def is_filled_allocation(self, node: ast.expr) -> TypeGuard[ast.Call]:
        """Return whether `node` creates an array and writes all its elements."""
        try:
            return isinstance(node, ast.Call) and resolve(node.func, self.function) in FILLED_ALLOCATIONS
        except (KeyError, AttributeError):
            return False

    def arguments(self, node: ast.Call, tally: Tally, index: bool) -> ast.Call:
        """Rewrite the arguments of a call."""
        if any(isinstance(argument, ast.Starred) for argument in node.args) or any(not k.arg for k in node.keywords):
            raise self.error(node, "passes * or ** arguments", "name each argument")
        arguments = [self.expression(argument, tally, index) for argument in node.args]
        keywords = [ast.keyword(k.arg, self.expression(k.value, tally, index)) for k in node.keywords]
        return ast.Call(node.func, arguments, keywords)

    def _kernel_call(self, node: ast.Call, callee: Any, tally: Tally, index: bool) -> ast.Call:
        name = PREFIX + ast.unparse(node.func).replace(".", "__")
        self.kernels[name] = callee
        call = self.arguments(node, tally, index)
        return ast.Call(load(name), [load(ARRAY), *call.args], call.keywords)

    def _cost(self, node: ast.AST, operator: ast.AST) -> tuple[str, ...]:
        if type(operator) not in OPERATORS:
            instead = "use + - * / // % << >> & | ^ ~ == != < <= > >="
            raise self.error(node, f"uses the operator {type(operator).__name__}", instead)
        return OPERATORS[type(operator)]
