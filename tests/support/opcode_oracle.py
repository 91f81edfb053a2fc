"""Counts what a kernel does by watching the interpreter run it: a second opinion on the counting build.

Arithmetic, comparisons and loops are counted from the bytecodes that are executed, loads and stores by the
arrays themselves, and whether an operation belongs to an index by where in the source it stands, found with
the tokenizer. Nothing here looks at a syntax tree.
"""

from __future__ import annotations

import builtins
import dis
import io
import math
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from codecbench.core.counting.kernel import Kernel
from codecbench.core.counting.operations import COUNTERS

BINARY = {
    "+": ("adds",), "-": ("adds",), "*": ("mults",), "/": ("mults", "divisions"), "//": ("mults", "divisions"),
    "%": ("mults", "divisions"), "<<": ("shifts",), ">>": ("shifts",), "&": ("bit_ops",), "|": ("bit_ops",),
    "^": ("bit_ops",),
}  # fmt: skip
UNARY = {"UNARY_NEGATIVE": ("adds",), "UNARY_INVERT": ("bit_ops",)}
ROUNDINGS = ("floor", "ceil", "trunc", "rint", "fabs")
ELEMENTARY = ("sqrt", "exp", "log", "log2", "log10", "sin", "cos", "tan")
ALLOCATIONS = ("empty", "zeros", "ones", "full", "empty_like", "zeros_like", "ones_like", "full_like")
PASSING = ("COPY", "TO_BOOL", "EXTENDED_ARG", "CACHE", "NOP", "NOT_TAKEN")
"""Bytecodes that come between a comparison and the jump that depends on it."""


class Cells:
    """An array that counts every element loaded and stored."""

    def __init__(self, array: np.ndarray, counts: Counter[str]) -> None:
        self.array, self.counts = array, counts
        self.shape, self.size, self.ndim, self.dtype = array.shape, array.size, array.ndim, array.dtype

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, index: Any) -> Any:
        found = self.array[index]
        if isinstance(found, np.ndarray):
            return Cells(found, self.counts)
        self.counts["reads"] += 1
        return found if found.dtype in (np.float32, np.uint64) else found.item()

    def __setitem__(self, index: Any, value: Any) -> None:
        self.counts["writes"] += self.array[index].size
        self.array[index] = value


class Oracle:
    """Runs kernels in the interpreter and counts."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._code: dict[CodeType, tuple[dict[int, dis.Instruction], set[int]]] = {}
        self._functions: dict[FunctionType, FunctionType] = {}
        self._inside_index = False
        self._loop: dis.Instruction | None = None
        self._previous = ""

    def run(self, kernel: Kernel, *arguments: Any) -> Any:
        wrapped = [self._wrap(argument) for argument in arguments]
        function = self._interpreted(kernel.python)
        with self._watched():
            result = function(*wrapped)
        return self._unwrap(result)

    @property
    def counters(self) -> list[int]:
        return [self.counts[name] for name in COUNTERS]

    def _wrap(self, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(self._wrap(part) for part in value)
        return Cells(value, self.counts) if isinstance(value, np.ndarray) else value

    def _unwrap(self, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(self._unwrap(part) for part in value)
        return value.array if isinstance(value, Cells) else value

    def _interpreted(self, function: FunctionType) -> FunctionType:
        """`function` with kernels, arrays and functions among its globals replaced by ones that count."""
        if function in self._functions:
            return self._functions[function]
        namespace: dict[str, Any] = dict(vars(builtins))
        copy = FunctionType(function.__code__, namespace, function.__name__, function.__defaults__)
        self._functions[function] = copy
        self._code[function.__code__] = _instructions(function.__code__)
        names = function.__code__.co_names
        namespace |= {name: self._global(function.__globals__[name]) for name in names if name in function.__globals__}
        namespace |= {
            "min": self._function(min, "comparisons"),
            "max": self._function(max, "comparisons"),
            "abs": self._function(abs, "adds"),
            "round": self._function(round, "adds"),
        }
        return copy

    def _global(self, value: Any) -> Any:
        if isinstance(value, Kernel):
            return self._interpreted(value.python)
        if value is np or value is math:
            return self._module(value)
        if isinstance(value, ModuleType):
            return SimpleNamespace(**{name: self._global(part) for name, part in vars(value).items() if name[0] != "_"})
        return self._wrap(value)

    def _module(self, module: ModuleType) -> SimpleNamespace:
        shim = SimpleNamespace(pi=math.pi, **{k: v for k, v in vars(np).items() if isinstance(v, type)})
        for names, counters in ((ROUNDINGS, ("adds",)), (ELEMENTARY, ("mults", "divisions"))):
            for name in names:
                if hasattr(module, name):
                    setattr(shim, name, self._function(getattr(module, name), *counters))
        for kind in ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "intp"):
            setattr(shim, kind, _integer(getattr(np, kind)))
        for name in ALLOCATIONS:
            setattr(shim, name, self._allocation(getattr(np, name), name))
        return shim

    def _function(self, function: Any, *counters: str) -> Any:
        def counting(*arguments: Any) -> Any:
            times = len(arguments) - 1 if function in (min, max) else 1
            self._count(counters, times)
            return function(*arguments)

        return counting

    def _allocation(self, allocate: Any, name: str) -> Any:
        def allocation(first: Any, *others: Any) -> Cells:
            types = [getattr(other, "numpy_type", other) for other in others]
            made = allocate(first.array if isinstance(first, Cells) else first, *types)
            self.counts["writes"] += 0 if name.startswith("empty") else made.size
            return Cells(made, self.counts)

        return allocation

    def _count(self, counters: tuple[str, ...], times: int = 1) -> None:
        for name in ("index_ops",) if self._inside_index and counters else counters:
            self.counts[name] += times

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Calls `_at` before every instruction of these functions."""
        if sys.version_info < (3, 12):
            before = sys.gettrace()
            sys.settrace(self._trace)
            try:
                yield
            finally:
                sys.settrace(before)
            return
        watching = sys.monitoring  # from Python 3.12 on tracing misses what a function does when it first runs
        tool, event = watching.DEBUGGER_ID, watching.events.INSTRUCTION
        watching.use_tool_id(tool, "oracle")
        watching.register_callback(tool, event, self._at)
        for code in self._code:
            watching.set_local_events(tool, code, event)
        try:
            yield
        finally:
            for code in self._code:
                watching.set_local_events(tool, code, watching.events.NO_EVENTS)
            watching.register_callback(tool, event, None)
            watching.free_tool_id(tool)

    def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        if frame.f_code not in self._code:
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if event == "opcode":
            self._at(frame.f_code, frame.f_lasti)
        return self._trace

    def _at(self, code: CodeType, offset: int) -> None:
        instructions, indexing = self._code[code]
        step = instructions[offset]
        if self._loop is not None and self._loop.offset < offset < self._loop.argval:  # a turn of its body begins
            self.counts["index_ops"] += 2
        self._loop = step if step.opname == "FOR_ITER" else None
        self._inside_index = offset in indexing
        self._step(step, self._previous)
        if step.opname not in PASSING:
            self._previous = step.opname

    def _step(self, step: dis.Instruction, previous: str) -> None:
        name = step.opname
        if name == "BINARY_OP":
            self._count(BINARY.get(step.argrepr.rstrip("="), ()))
        elif name in UNARY:
            self._count(UNARY[name])
        elif name == "COMPARE_OP":
            self._count(("comparisons",))
        elif name == "UNARY_NOT" or ("JUMP" in name and ("IF_TRUE" in name or "IF_FALSE" in name)):
            tested_before = previous in ("COMPARE_OP", "UNARY_NOT") or previous.startswith("JUMP_IF")
            self._count(() if tested_before else ("comparisons",))


class OracleTrace:
    """A trace that runs every kernel in the interpreter."""

    def __init__(self) -> None:
        self.oracles: dict[str, Oracle] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[Any]:
        yield self.oracles.setdefault(name, Oracle()).run

    @property
    def counters(self) -> dict[str, list[int]]:
        return {name: oracle.counters for name, oracle in self.oracles.items()}


def _integer(numpy_type: Any) -> Any:
    """A conversion to an integer that wraps like the type but computes like Python from there on."""

    def convert(value: Any) -> int:
        return int(np.array(int(value)).astype(numpy_type))

    convert.numpy_type = numpy_type  # type: ignore[attr-defined]
    return convert


def _instructions(code: CodeType) -> tuple[dict[int, dis.Instruction], set[int]]:
    """The instructions of a function by offset, and the offsets of those that stand in an index."""
    regions = _index_regions(code.co_filename)
    steps = list(dis.get_instructions(code))
    instructions = {step.offset: step for step in steps}
    for prefix, step in reversed(list(pairwise(steps))):
        if prefix.opname == "EXTENDED_ARG":  # the interpreter goes straight on and reports the prefix alone
            instructions[prefix.offset] = instructions[step.offset]
    inside = set()
    for offset, step in instructions.items():
        where = step.positions
        if where is None or where.lineno is None:
            continue
        start, end = (where.lineno, where.col_offset), (where.end_lineno, where.end_col_offset)
        if any(first <= start and end <= last for first, last in regions):  # type: ignore[operator]
            inside.add(offset)
    return instructions, inside


def _index_regions(filename: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Where in a file the insides of subscripts, of range(...) and of allocations begin and end."""
    tokens = list(tokenize.generate_tokens(io.StringIO(Path(filename).read_text()).readline))
    regions, open_ = [], []
    for before, token in zip([None, *tokens], tokens, strict=False):
        if token.string in "([{" and token.type == tokenize.OP:
            named = before is not None and (before.type == tokenize.NAME or before.string in (")", "]"))
            subscript = token.string == "[" and named
            call = token.string == "(" and named and before.string in ("range", *ALLOCATIONS)  # type: ignore[union-attr]
            open_.append((token.end, subscript or call))
        elif token.string in ")]}" and token.type == tokenize.OP:
            start, counts = open_.pop()
            if counts:
                regions.append((start, token.start))
    return regions
