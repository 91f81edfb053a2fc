"""The source of a kernel as a tree, and a fingerprint of everything that its compiled code depends on."""

from __future__ import annotations

import ast
import builtins
import dis
import functools
import hashlib
import inspect
import textwrap
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


class SourceError(TypeError):
    """The source of a kernel cannot be read or does not belong to the function that runs."""


def function_tree(function: FunctionType) -> ast.FunctionDef:
    """The definition of `function` without decorators, annotations and docstring.

    Raises SourceError where there is no source, where the file was edited since it was imported, and for
    functions that close over variables: what such a function does is not in its source.
    """
    if function.__closure__:
        names = ", ".join(function.__code__.co_freevars)
        raise SourceError(f"kernel {function.__qualname__} closes over {names}; pass them as arguments")
    try:
        lines, first = inspect.getsourcelines(function)
    except (OSError, TypeError) as error:
        raise SourceError(f"kernel {function.__qualname__} has no source to read: {error}") from error
    tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise SourceError(f"kernel {function.__qualname__} is not a function definition")
    ast.increment_lineno(tree, first - 1)
    tree.decorator_list = []
    if _content(_compiled(tree, function)) != _content(function.__code__):
        raise SourceError(
            f"{function.__code__.co_filename}:{first}: kernel {function.__qualname__} is not what was imported; "
            f"the file was edited meanwhile: start again"
        )
    _strip(tree)
    return tree


def _content(code: CodeType) -> str:
    """What code does, whatever its module imports: that decides how attributes are called, and so where jumps go."""
    jumps = {*dis.hasjrel, *dis.hasjabs}
    steps = [
        (step.opname.replace("LOAD_METHOD", "LOAD_ATTR"), None if step.opcode in jumps else _plain(step.argval))
        for step in dis.get_instructions(code)
        if step.opname not in ("PUSH_NULL", "EXTENDED_ARG")
    ]
    return repr(([_plain(constant) for constant in code.co_consts], code.co_varnames, steps))


def _plain(value: object) -> object:
    return _content(value) if isinstance(value, CodeType) else value


def _strip(tree: ast.FunctionDef) -> None:
    tree.returns = None
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
    if ast.get_docstring(tree, clean=False) is not None and len(tree.body) > 1:
        tree.body = tree.body[1:]


def _compiled(tree: ast.FunctionDef, function: FunctionType) -> CodeType:
    lazy = ast.ImportFrom("__future__", [ast.alias("annotations", lineno=1, col_offset=0)], 0, lineno=1, col_offset=0)
    outer = compile(ast.Module([lazy, tree], []), function.__code__.co_filename, "exec", dont_inherit=True)
    named = (constant for constant in outer.co_consts if isinstance(constant, CodeType))
    return next(code for code in named if code.co_name == tree.name)


def resolve(node: ast.expr, function: FunctionType) -> Any:
    """The value of a global name, or of an attribute of a global module, as `function` sees it.

    Raises KeyError for local names, unknown names and attributes of anything but a module.
    """
    if isinstance(node, ast.Name):
        if node.id in function.__code__.co_varnames:
            raise KeyError(node.id)
        return function.__globals__[node.id] if node.id in function.__globals__ else vars(builtins)[node.id]
    if isinstance(node, ast.Attribute):
        owner = resolve(node.value, function)
        if isinstance(owner, ModuleType):
            return getattr(owner, node.attr)
    raise KeyError(ast.unparse(node))


def fingerprint(function: FunctionType, options: dict[str, Any]) -> str:
    """Hex digest of a kernel's code, of its options, of every constant that it reads and every kernel it calls.

    It changes with anything that can change the compiled code, in whichever file that stands, and not with
    comments or with where the function stands in its file. Functions that write machine code themselves (numba's
    intrinsics) are covered by the whole file that they stand in.
    """
    digest = hashlib.sha256()
    reached = {function: _spelled(options)}
    for next_function in (waiting := [function]):
        own, callees = _own_digest(next_function, reached[next_function])
        digest.update(own)
        for callee, spelled in callees:
            if callee not in reached:
                reached[callee] = spelled
                waiting.append(callee)
    return digest.hexdigest()


def _spelled(options: dict[str, Any]) -> str:
    return repr(sorted(options.items()))


@functools.cache
def _own_digest(function: FunctionType, options: str) -> tuple[bytes, tuple[tuple[FunctionType, str], ...]]:
    """Digest of a function and the constants that it reads, and the compiled functions that it calls by name."""
    tree = function_tree(function)
    digest = hashlib.sha256(ast.dump(tree).encode())
    digest.update(repr((options, function.__defaults__)).encode())
    seen: set[str] = set()
    callees = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Name | ast.Attribute) or (name := ast.unparse(node)) in seen:
            continue
        seen.add(name)
        try:
            value = resolve(node, function)
        except (KeyError, AttributeError):
            continue
        digest.update(f"{name}={_describe(value, name, function)};".encode())
        compiled = getattr(value, "py_func", None)  # a numba dispatcher, or a kernel, which offers the same name
        if isinstance(compiled, FunctionType):
            callee_options = getattr(value, "options", None) or getattr(value, "targetoptions", {})
            callees.append((compiled, _spelled(dict(callee_options))))
    return digest.digest(), tuple(callees)


def _describe(value: Any, name: str, reader: FunctionType) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype.str}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"({','.join(_describe(part, name, reader) for part in value)})"
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic | np.dtype) or value is None:
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(writer := getattr(value, "_defn", None), FunctionType):  # an intrinsic
        return hashlib.sha256(inspect.getsource(inspect.getmodule(writer) or writer).encode()).hexdigest()
    if isinstance(value, type | BuiltinFunctionType | FunctionType | np.ufunc) or callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__name__)}"
    raise SourceError(
        f"kernel {reader.__qualname__} reads the global {name}, a {type(value).__name__}; allowed are numbers, "
        f"arrays, tuples of these and kernels"
    )
