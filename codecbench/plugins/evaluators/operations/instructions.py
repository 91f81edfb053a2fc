"""Machine instructions, counted by callgrind and sorted into the paper's classes.

An x86-64 instruction belongs to the class of what it computes, once, however many lanes it works on, and adds
a read and a write for each memory operand that it reads and writes; a fused multiply-add counts in both
classes. Moves between registers, conversions, shuffles and jumps belong to none.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from codecbench.core.counting.operations import CLASSES, OperationCounts

_PATTERNS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"v?f(n?m)(add|sub)|v?pmadd|vpdp", ("mults", "adds")),
    (r"v?(i?div|sqrt|fdiv|fsqrt|rcp|rsqrt)", ("mults", "divisions")),
    (r"v?(i?mul|pmul|fmul|mulx|dpp)", ("mults",)),
    (r"v?p?(sll|srl|sra)|sh[lr]|sa[lr]|ro[lr]|rc[lr]|v?pro[lr]", ("shifts",)),
    (r"v?(cmp|pcmp|test|ptest|u?comis|p?max|p?min|fcom|fucom)|v?(max|min)[sp][sd]", ("comparisons",)),
    (r"v?(p?and|p?or|p?xor)|not$|bt|bs[fr]|[lt]zcnt|popcnt|bzhi|bextr|bls|pdep|pext|vpternlog", ("bit_ops",)),
    (
        r"v?p?(add|sub|hadd|hsub)|adc|sbb|inc|dec|neg|v?psad|v?pabs|v?pavg|v?psign|lea$|xadd|fi?(add|sub)|fabs|fchs"
        r"|v?round|frnd",
        ("adds",),
    ),
)


def counters_of(mnemonic: str) -> tuple[str, ...]:
    """The counters that an instruction with this mnemonic adds to, memory aside."""
    name = mnemonic.lower()
    return next((counters for pattern, counters in _PATTERNS if re.match(pattern, name)), ())


def read_profile(lines: Iterable[str]) -> dict[str, Counter[int]]:
    """How often the instruction at each address of each object was executed.

    `lines` are a callgrind profile written with --dump-instr=yes and neither strings nor positions compressed.
    """
    executed: dict[str, Counter[int]] = {}
    current: Counter[int] = Counter()
    inclusive = False
    for line in lines:
        if line.startswith("ob="):
            current = executed.setdefault(line[3:].strip(), Counter())
        elif line.startswith("calls="):
            inclusive = True  # the next cost is that of the function called, counted where it stands
        elif line.startswith("0x"):
            fields = line.split()
            if not inclusive and len(fields) > 2:
                current[int(fields[0], 16)] += int(fields[2])
            inclusive = False
    return executed


def relocated(objects: dict[str, Counter[int]], code: dict[str, list[tuple[int, bytes]]]) -> dict[str, Counter[int]]:
    """The profile with what was executed outside of its object's code given to the object that it belongs to.

    A jump, rather than a call, from one library into another leaves callgrind in the first. The other is known
    by having executed the same address on its own account.
    """
    found = {name: Counter[int]() for name in objects}
    for name, addresses in objects.items():
        for address, times in addresses.items():
            owner = name
            if not _covers(code[name], address):
                others = (other for other in objects if address in objects[other] and _covers(code[other], address))
                owner = next(others, name)
            found[owner][address] += times
    return found


def _covers(code: list[tuple[int, bytes]], address: int) -> bool:
    return any(0 <= address - start < len(text) for start, text in code)


def classified(executed: Counter[int], code: list[tuple[int, bytes]]) -> tuple[OperationCounts, int]:
    """Counts of executed instructions, and how many lie outside `code`, which is (address, bytes) pieces."""
    import iced_x86

    names = {value: name for name, value in vars(iced_x86.Mnemonic).items() if isinstance(value, int)}
    factory = iced_x86.InstructionInfoFactory()
    pieces = [(start, memoryview(text)) for start, text in code]
    totals: Counter[str] = Counter()
    unknown = 0
    for address, times in executed.items():
        piece = next((text[address - start :][:15] for start, text in pieces if 0 <= address - start < len(text)), None)
        if piece is None:
            unknown += times
            continue
        instruction = iced_x86.Decoder(64, bytes(piece), ip=address).decode()
        for counter in (*counters_of(names[instruction.mnemonic]), *_accesses(factory.info(instruction), iced_x86)):
            totals[counter] += times
    return OperationCounts(**{name: totals[name] for name in (*CLASSES, "divisions")}), unknown


def _accesses(info: Any, iced_x86: Any) -> Iterator[str]:
    access = iced_x86.OpAccess
    for memory in info.used_memory():
        if memory.access in (access.READ, access.COND_READ, access.READ_WRITE, access.READ_COND_WRITE):
            yield "reads"
        if memory.access in (access.WRITE, access.COND_WRITE, access.READ_WRITE, access.READ_COND_WRITE):
            yield "writes"


def object_code(file: Path) -> list[tuple[int, bytes]]:
    """The executable segments of an ELF file as (virtual address, bytes)."""
    from elftools.elf.elffile import ELFFile

    with file.open("rb") as stream:
        segments = ELFFile(stream).iter_segments("PT_LOAD")
        return [(segment["p_vaddr"], segment.data()) for segment in segments if segment["p_flags"] & 1]
