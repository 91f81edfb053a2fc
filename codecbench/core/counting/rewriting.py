"""The counting build of a kernel: the same syntax tree, with counters that follow the path taken.

Each statement is preceded by additions of its certain cost. Expressions that only some paths evaluate count themselves
in place, as `counted(counters, (1, 0, ...), expression)`: the rest of `and`, `or` and chained comparisons, the branches
of `x if c else y`, the condition of `while`. The counters of statements are local integers, which the compiler keeps in
registers; before every return they are added to the caller's array.
"""

from __future__ import annotations

import ast
from collections import Counter
from types import FunctionType
from typing import Any

from codecbench.core.counting.expressions import ARRAY, PREFIX, Expressions, Tally, load, takes_view
from codecbench.core.counting.operations import COUNTERS


def counting_tree(tree: ast.FunctionDef, function: FunctionType) -> tuple[ast.FunctionDef, dict[str, Any]]:
    """Return the counting build of the definition `tree` of `function`, and the kernels that it calls.

    The definition takes the counters, an int64 array in the order of COUNTERS, before the function's arguments. The
    kernels are keyed by the names under which the definition calls their counting builds. Raises UncountableError for
    syntax and calls outside the language of kernels.
    """
    rewriter = _Statements(function)
    body = rewriter.block(tree.body)
    counters = [name for name in COUNTERS if name in rewriter.used_counters]
    start = [assignment(PREFIX + name, ast.Constant(0)) for name in counters]
    exits = _Exits(counters)
    falls_through = not isinstance(body[-1], ast.Return)
    statements = [*start, *map(exits.visit, body), *(exits.flush() if falls_through else [])]
    flat = [part for item in statements for part in (item if isinstance(item, list) else [item])]
    arguments = ast.arguments(
        posonlyargs=[],
        args=[ast.arg(ARRAY), *(ast.arg(name.arg) for name in (*tree.args.posonlyargs, *tree.args.args))],
        kwonlyargs=[],
        kw_defaults=[],
        defaults=[],
    )
    if tree.args.vararg or tree.args.kwarg or tree.args.kwonlyargs:
        raise rewriter.error(tree, "has *, ** or keyword-only parameters", "name each argument")
    counting = ast.FunctionDef(tree.name + "__counting", arguments, flat, decorator_list=[])
    return ast.fix_missing_locations(ast.copy_location(counting, tree)), rewriter.kernels


def assignment(name: str, value: ast.expr) -> ast.stmt:
    """Create the statement `name = value`."""
    return ast.Assign([ast.Name(name, ast.Store())], value)


class _Exits(ast.NodeTransformer):
    """Adds the local counters to the array before every return."""

    def __init__(self, counters: list[str]) -> None:
        self._counters = counters
        self._returns = 0

    def flush(self) -> list[ast.stmt]:
        return [
            ast.AugAssign(
                ast.Subscript(load(ARRAY), ast.Constant(COUNTERS.index(name)), ast.Store()),
                ast.Add(),
                load(PREFIX + name),
            )
            for name in self._counters
        ]

    def visit_Return(self, node: ast.Return) -> list[ast.stmt]:
        if node.value is None or isinstance(node.value, ast.Constant):
            return [*self.flush(), node]
        self._returns += 1
        value = f"{PREFIX}value{self._returns}"
        return [assignment(value, node.value), *self.flush(), ast.Return(load(value))]


class _Statements(Expressions):
    """Rewrites each statement into the additions of its certain cost, then the statement itself."""

    _views = 0

    def block(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        return [part for statement in statements for part in self.statement(statement)]

    def statement(self, node: ast.stmt) -> list[ast.stmt]:
        if isinstance(node, ast.Pass | ast.Break | ast.Continue | ast.Raise):
            return [node]
        rewrite = getattr(self, f"_{type(node).__name__.lower()}", None)
        if rewrite is None:
            what = f"uses {ast.unparse(node).splitlines()[0]!r}"
            raise self.error(node, what, "use assignments, if, for over range, while and return")
        tally: Tally = Counter()
        rewritten = [ast.copy_location(part, node) for part in rewrite(node, tally)]
        return [*self._additions(tally, node), *rewritten]

    def _additions(self, tally: Tally, node: ast.stmt) -> list[ast.stmt]:
        return [
            ast.copy_location(ast.AugAssign(ast.Name(PREFIX + name, ast.Store()), ast.Add(), ast.Constant(times)), node)
            for name, times in tally.items()
        ]

    def _target(self, node: ast.expr, tally: Tally) -> ast.expr:
        if isinstance(node, ast.Name):
            self._name(node, tally, False)
            return node
        if isinstance(node, ast.Tuple | ast.List):
            return ast.Tuple([self._target(part, tally) for part in node.elts], ast.Store())
        if isinstance(node, ast.Subscript) and not takes_view(node):
            self.add(tally, ("writes",))
            return self.element(node, tally)
        raise self.error(node, f"assigns to {ast.unparse(node)!r}", "assign to names and to elements of arrays")

    def _expr(self, node: ast.Expr, tally: Tally) -> list[ast.stmt]:
        if isinstance(node.value, ast.Constant):
            return [ast.Pass()]
        return [ast.Expr(self.expression(node.value, tally))]

    def _assign(self, node: ast.Assign, tally: Tally) -> list[ast.stmt]:
        target = node.targets[0]
        if len(node.targets) == 1 and isinstance(target, ast.Subscript) and takes_view(target):
            return self._fill(target, self.expression(node.value, tally), tally)
        if len(node.targets) == 1 and isinstance(target, ast.Name) and self.is_filled_allocation(node.value):
            allocation = ast.Assign([target], self.arguments(node.value, tally, True))
            return [allocation, self._count_writes(target.id)]
        value = self.expression(node.value, tally)
        return [ast.Assign([self._target(target, tally) for target in node.targets], value)]

    def _fill(self, target: ast.Subscript, value: ast.expr, tally: Tally) -> list[ast.stmt]:
        """Rewrite `a[i, :] = value`: one write for each element; the type check ensures that the value is a number."""
        self._views += 1
        filling, view = f"{PREFIX}filling{self._views}", f"{PREFIX}view{self._views}"
        part = self.element(target, tally)
        part.ctx = ast.Load()
        everything = ast.Subscript(load(view), ast.Constant(...), ast.Store())
        return [
            assignment(filling, value),
            assignment(view, part),
            self._count_writes(view),
            ast.Assign([everything], load(filling)),
        ]

    def _count_writes(self, array: str) -> ast.stmt:
        """Create the statement that counts one write for each element of an array."""
        self.used_counters.add("writes")
        size = ast.Attribute(load(array), "size", ast.Load())
        return ast.AugAssign(ast.Name(PREFIX + "writes", ast.Store()), ast.Add(), size)

    def _annassign(self, node: ast.AnnAssign, tally: Tally) -> list[ast.stmt]:
        if node.value is None:
            return [ast.Pass()]
        return self._assign(ast.Assign([node.target], node.value), tally)

    def _augassign(self, node: ast.AugAssign, tally: Tally) -> list[ast.stmt]:
        self.add(tally, self._cost(node, node.op))
        if isinstance(node.target, ast.Subscript):
            self.add(tally, ("reads",))
        target = self._target(node.target, tally)
        return [ast.AugAssign(target, node.op, self.expression(node.value, tally))]  # type: ignore[arg-type]

    def _return(self, node: ast.Return, tally: Tally) -> list[ast.stmt]:
        return [ast.Return(node.value and self.expression(node.value, tally))]

    def _if(self, node: ast.If, tally: Tally) -> list[ast.stmt]:
        return [ast.If(self.truth(node.test, tally), self.block(node.body), self.block(node.orelse))]

    def _while(self, node: ast.While, tally: Tally) -> list[ast.stmt]:
        turn: Tally = Counter()  # cost of each evaluation: one before every turn, and the one that ends the loop
        test = self.truth(node.test, turn)
        body = [*self._additions(turn, node), *self.block(node.body)]
        return [ast.While(test, body, [*self._additions(turn, node), *self.block(node.orelse)])]

    def _for(self, node: ast.For, tally: Tally) -> list[ast.stmt]:
        bounds = node.iter
        if not (isinstance(bounds, ast.Call) and isinstance(bounds.func, ast.Name) and bounds.func.id == "range"):
            raise self.error(node, f"loops over {ast.unparse(bounds)!r}", "loop over range(...)")
        turn: Tally = Counter()
        self.add(turn, ("index_ops",), times=2)
        body = [*self._additions(turn, node), *self.block(node.body)]
        return [ast.For(node.target, self.arguments(bounds, tally, True), body, self.block(node.orelse))]
