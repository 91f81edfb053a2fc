"""The source of a kernel as a tree, and a fingerprint of everything that its compiled code depends on."""

from __future__ import annotations

import ast
import builtins
import dis
import functools
import hashlib
import inspect
import textwrap
from collections.abc import Iterator
from pathlib import Path
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
    refuse_closure(function)
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


def refuse_closure(function: FunctionType) -> None:
    """Raise SourceError for a function that closes over variables: what it does depends on who made it."""
    if function.__closure__:
        names = ", ".join(function.__code__.co_freevars)
        raise SourceError(f"kernel {function.__qualname__} closes over {names}; pass them as arguments")


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
    intrinsics) are covered by the whole file that they stand in. Raises SourceError for functions that close over
    variables and for globals that are neither constants nor functions.
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
    refuse_closure(function)
    digest = hashlib.sha256(_spelled_code(function.__code__, function.__doc__).encode())
    digest.update(repr((options, function.__defaults__)).encode())
    callees = []
    for name, value in _named(function):
        digest.update(f"{name}={_describe(value, name, function)};".encode())
        compiled = getattr(value, "py_func", None)  # a numba dispatcher, or a kernel, which offers the same name
        if isinstance(compiled, FunctionType):
            callee_options = getattr(value, "options", None) or getattr(value, "targetoptions", {})
            callees.append((compiled, _spelled(dict(callee_options))))
    return digest.digest(), tuple(callees)


def _spelled_code(code: CodeType, docstring: str | None = None) -> str:
    """Everything of a code object but where it stands and its docstring."""
    constants = [_spelled_constant(constant) for constant in code.co_consts if constant != docstring]
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    body = (code.co_code.hex(), code.co_exceptiontable, code.co_names, code.co_varnames)
    return repr((code.co_name, body, counts, constants))


def _spelled_constant(constant: object) -> str:
    if isinstance(constant, CodeType):
        return _spelled_code(constant)
    return repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant)


def _named(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """The globals that a function names, and what it takes from modules among them, by dotted names."""
    names = _names(function.__code__)
    waiting = [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    while waiting:
        name, value = waiting.pop()
        yield name, value
        if isinstance(value, ModuleType):
            parts = (part for part in names if part not in name.split("."))
            waiting += [(f"{name}.{part}", getattr(value, part)) for part in parts if hasattr(value, part)]


def _names(code: CodeType) -> list[str]:
    inner = (name for part in code.co_consts if isinstance(part, CodeType) for name in _names(part))
    return sorted({*code.co_names, *inner})


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
        return _file_digest(writer.__code__.co_filename)
    if isinstance(value, type | BuiltinFunctionType | FunctionType | np.ufunc) or callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__name__)}"
    raise SourceError(
        f"kernel {reader.__qualname__} reads the global {name}, a {type(value).__name__}; allowed are numbers, "
        f"arrays, tuples of these and kernels"
    )


@functools.cache
def _file_digest(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise SourceError(f"{path}, which writes machine code, cannot be read: {error}") from error
