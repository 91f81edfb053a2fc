"""Syntax trees of kernels, and fingerprints of all that their compiled code depends on."""

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
    """Return the definition of `function` without decorators, annotations and docstring.

    Raises SourceError if there is no source, if the file was edited since it was imported, and for functions that close
    over variables: their source does not determine what they do.
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
    if _behavior(_compile(tree, function)) != _behavior(function.__code__):
        raise SourceError(
            f"{function.__code__.co_filename}:{first}: kernel {function.__qualname__} is not what was imported; "
            f"the file was edited meanwhile: start again"
        )
    _strip(tree)
    return tree


def refuse_closure(function: FunctionType) -> None:
    """Raise SourceError if a function closes over variables: its behavior depends on where it was created."""
    if function.__closure__:
        names = ", ".join(function.__code__.co_freevars)
        raise SourceError(f"kernel {function.__qualname__} closes over {names}; pass them as arguments")


def _behavior(code: CodeType) -> str:
    """Return a text of what code does, independent of its module's imports, which change method calls and jumps."""
    jumps = {*dis.hasjrel, *dis.hasjabs}
    steps = [
        (step.opname.replace("LOAD_METHOD", "LOAD_ATTR"), None if step.opcode in jumps else _plain(step.argval))
        for step in dis.get_instructions(code)
        if step.opname not in ("PUSH_NULL", "EXTENDED_ARG")
    ]
    return repr(([_plain(constant) for constant in code.co_consts], code.co_varnames, steps))


def _plain(value: object) -> object:
    return _behavior(value) if isinstance(value, CodeType) else value


def _strip(tree: ast.FunctionDef) -> None:
    tree.returns = None
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
    if ast.get_docstring(tree, clean=False) is not None and len(tree.body) > 1:
        tree.body = tree.body[1:]


def _compile(tree: ast.FunctionDef, function: FunctionType) -> CodeType:
    lazy = ast.ImportFrom("__future__", [ast.alias("annotations", lineno=1, col_offset=0)], 0, lineno=1, col_offset=0)
    outer = compile(ast.Module([lazy, tree], []), function.__code__.co_filename, "exec", dont_inherit=True)
    codes = (constant for constant in outer.co_consts if isinstance(constant, CodeType))
    return next(code for code in codes if code.co_name == tree.name)


def resolve(node: ast.expr, function: FunctionType) -> Any:
    """Return the value of a global name, or of an attribute of a global module, as `function` sees it.

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
    """Return a hex digest of a kernel's code and options, every constant that it reads and every kernel that it calls.

    It changes with anything that can change the compiled code, in whatever file, but not with comments or the
    function's place in its file. Functions that emit machine code themselves (numba's intrinsics) count with their
    whole file. Raises SourceError for functions that close over variables, and for globals that are neither constants
    nor functions.
    """
    digest = hashlib.sha256()
    options_of = {function: _options_text(options)}
    for next_function in (queue := [function]):
        function_digest, callees = _function_digest(next_function, options_of[next_function])
        digest.update(function_digest)
        for callee, callee_options in callees:
            if callee not in options_of:
                options_of[callee] = callee_options
                queue.append(callee)
    return digest.hexdigest()


def _options_text(options: dict[str, Any]) -> str:
    return repr(sorted(options.items()))


@functools.cache
def _function_digest(function: FunctionType, options: str) -> tuple[bytes, tuple[tuple[FunctionType, str], ...]]:
    """Return a digest of a function and the constants that it reads, and the compiled functions that it calls."""
    refuse_closure(function)
    digest = hashlib.sha256(_code_text(function.__code__, function.__doc__).encode())
    digest.update(repr((options, function.__defaults__)).encode())
    callees = []
    for name, value in _referenced_globals(function):
        digest.update(f"{name}={_describe(value, name, function)};".encode())
        compiled = getattr(value, "py_func", None)  # a numba dispatcher, or a kernel, which offers the same name
        if isinstance(compiled, FunctionType):
            callee_options = getattr(value, "options", None) or getattr(value, "targetoptions", {})
            callees.append((compiled, _options_text(dict(callee_options))))
    return digest.digest(), tuple(callees)


def _code_text(code: CodeType, docstring: str | None = None) -> str:
    """Return a text of everything in a code object but its place and docstring."""
    constants = [_constant_text(constant) for constant in code.co_consts if constant != docstring]
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    body = (code.co_code.hex(), code.co_exceptiontable, code.co_names, code.co_varnames)
    return repr((code.co_name, body, counts, constants))


def _constant_text(constant: object) -> str:
    if isinstance(constant, CodeType):
        return _code_text(constant)
    return repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant)


def _referenced_globals(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the globals that a function refers to, and the attributes of modules among them, by dotted names."""
    names = _names(function.__code__)
    stack = [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    while stack:
        name, value = stack.pop()
        yield name, value
        if isinstance(value, ModuleType):
            parts = (part for part in names if part not in name.split("."))
            stack += [(f"{name}.{part}", getattr(value, part)) for part in parts if hasattr(value, part)]


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
