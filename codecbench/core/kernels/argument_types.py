"""Argument types of kernels as readable text.

    int64    float64[:, ::1]    readonly(uint8[::1])    (float64, float64)    omitted(7)    none
    named("package.module:Views", float64[:, ::1], int64[::1])

Arrays are written as in numba: `::1` marks the contiguous dimension. `named` is a named tuple, by its class and the
types of its fields.
"""

from __future__ import annotations

import ast
import importlib
from typing import Any

import numba.core.types

types: Any = numba.core.types  # numba is typed in part, and differently in each version

_SCALARS = {str(scalar): scalar for scalar in (*types.number_domain, types.boolean)}
_DIMENSIONS = {"C": (":", "::1"), "F": ("::1", ":"), "A": (":", ":")}


class ArgumentTypeError(ValueError):
    """A type has no text, or a text names no type."""


def text_from_types(arguments: tuple[Any, ...]) -> str:
    """Return the types of a call's arguments, separated by commas. Raises ArgumentTypeError if one has no text."""
    return ", ".join(map(_text, arguments))


def types_from_text(text: str) -> tuple[Any, ...]:
    """Parse the text of `text_from_types` into numba types. Raises ArgumentTypeError for anything else."""
    try:
        tree = ast.parse(f"({text},)" if text else "()", mode="eval").body
        return tuple(_type(part) for part in tree.elts)  # type: ignore[attr-defined]
    except (SyntaxError, KeyError, ValueError, TypeError, AttributeError, ImportError) as error:
        raise ArgumentTypeError(f"{text!r} is not a list of argument types: {type(error).__name__}: {error}") from error


def _text(numba_type: Any) -> str:
    if str(numba_type) in _SCALARS:
        return str(numba_type)
    if isinstance(numba_type, types.Array) and numba_type.aligned and type(numba_type) is types.Array:
        return _array_text(numba_type)
    if isinstance(numba_type, types.BaseNamedTuple):
        tuple_class = numba_type.instance_class
        return f'named("{tuple_class.__module__}:{tuple_class.__qualname__}", {text_from_types(tuple(numba_type))})'
    if isinstance(numba_type, types.BaseTuple):
        parts = text_from_types(tuple(numba_type))
        return f"({parts},)" if len(numba_type) == 1 else f"({parts})"
    if isinstance(numba_type, types.Omitted) and isinstance(numba_type.value, int | float | bool | None):
        return f"omitted({numba_type.value!r})"
    if isinstance(numba_type, types.NoneType):
        return "none"
    raise ArgumentTypeError(f"no text for the argument type {numba_type}; allowed are numbers, arrays and tuples")


def _array_text(array: Any) -> str:
    first, last = _DIMENSIONS[array.layout]
    dimensions = [":"] * array.ndim
    if dimensions:
        dimensions[0] = first
        dimensions[-1] = last if array.ndim > 1 or array.layout == "A" else "::1"
    text = f"{_text(array.dtype)}[{', '.join(dimensions) or '()'}]"
    return text if array.mutable else f"readonly({text})"


def _type(node: ast.expr) -> Any:
    if isinstance(node, ast.Name):
        return types.none if node.id == "none" else _SCALARS[node.id]
    if isinstance(node, ast.Subscript):
        return _array(node)
    if isinstance(node, ast.Tuple):
        return types.BaseTuple.from_types([_type(part) for part in node.elts])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return _call(node.func.id, node.args)
    raise ValueError(ast.unparse(node))


def _array(node: ast.Subscript) -> Any:
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    steps = [ast.unparse(part) for part in parts]
    contiguous = [dimension for dimension, step in enumerate(steps) if step == "::1"]
    if any(step not in (":", "::1") for step in steps) or len(contiguous) > 1:
        raise ValueError(ast.unparse(node))
    layouts = {len(steps) - 1: "C", 0: "F"} if len(steps) > 1 else {0: "C"}
    layout = layouts[contiguous[0]] if contiguous else "A" if steps else "C"
    return types.Array(_type(node.value), len(steps), layout)


def _call(name: str, arguments: list[ast.expr]) -> Any:
    """Return the type that is written as a call: `readonly`, `omitted` or `named`."""
    if name == "readonly":
        array = _type(arguments[0])
        return types.Array(array.dtype, array.ndim, array.layout, readonly=True)
    if name == "omitted":
        return types.Omitted(ast.literal_eval(arguments[0]))
    if name != "named":
        raise ValueError(f"{name}(...)")
    module, _, qualname = str(ast.literal_eval(arguments[0])).partition(":")
    tuple_class: Any = importlib.import_module(module)
    for part in qualname.split("."):
        tuple_class = getattr(tuple_class, part)
    return types.BaseTuple.from_types([_type(part) for part in arguments[1:]], tuple_class)
