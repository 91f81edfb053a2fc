"""Machine instructions of encoding and decoding one image, counted by callgrind and sorted into the paper's classes.

An x86-64 instruction belongs to the class of what it computes, once, however many lanes it works on. It adds a read
and a write for each memory operand that it reads and writes. A fused multiply-add counts in both classes. Moves between
registers, conversions, shuffles and jumps belong to none.
"""

from __future__ import annotations

import importlib.util
import pickle
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.image import Image
from codecbench.core.counting.operations import CLASSES, OperationCounts

_CHILD = "codecbench.plugins.evaluators.operations.machine_child"
_TIMEOUT_S = 1800.0
_MAX_UNKNOWN_SHARE = 0.005
_CALLGRIND = (
    "--tool=callgrind",
    "--dump-instr=yes",
    "--instr-atstart=no",
    "--compress-strings=no",
    "--compress-pos=no",
    "--quiet",
)


def reason_unavailable() -> str | None:
    """Why instructions cannot be counted on this machine, and what to install; None if they can."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return f"machine counts need an x86-64 processor; this is {platform.machine()}"
    if shutil.which("valgrind") is None:
        return "valgrind is not installed: apt-get install valgrind"
    modules = [name for name in ("iced_x86", "elftools") if importlib.util.find_spec(name) is None]
    return f"{' and '.join(modules)} not installed: pip install 'codecbench[machine]'" if modules else None


def count_executed(codec: AnyCodec[Any], image: Image) -> dict[str, OperationCounts]:
    """Operations of one encoding and one decoding, under `encode` and `decode`.

    The codec is prepared for the image, so a search for a rate is not counted. Both have run once before, so neither is
    compiling or loading. The instructions of the Python interpreter are left out; those of every library and of
    compiled kernels are included.
    """
    with tempfile.TemporaryDirectory(prefix="codecbench-machine-") as name:
        folder = Path(name)
        (folder / "task.pickle").write_bytes(pickle.dumps((type(codec), codec.params, image)))
        command = ["valgrind", *_CALLGRIND, f"--callgrind-out-file={folder / 'profile'}", sys.executable, "-m", _CHILD]
        run = subprocess.run([*command, name], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        if run.returncode != 0:
            raise RuntimeError(f"valgrind ended with status {run.returncode}: {run.stderr.strip()[-2000:]}")
        kernels = pickle.loads((folder / "kernels.pickle").read_bytes())
        return {
            direction: _count_profile(folder / f"profile.{number}", kernels)
            for number, direction in enumerate(("encode", "decode"), start=1)
        }


def _count_profile(profile: Path, kernels: list[tuple[int, bytes]]) -> OperationCounts:
    with profile.open() as lines:
        objects = read_profile(lines)
    code = {name: object_code(Path(name)) if Path(name).is_file() else kernels for name in objects}
    total, unknown, everything = OperationCounts(), 0, 0
    for name, addresses in reassign_to_owners(objects, code).items():
        if _is_interpreter(name):
            continue
        counts, lost = classify(addresses, code[name])
        total, unknown = total + counts, unknown + lost
        everything += addresses.total()
    if unknown > _MAX_UNKNOWN_SHARE * everything:
        raise RuntimeError(f"{unknown} of {everything} executed instructions are in no known code")
    return total


def _is_interpreter(name: str) -> bool:
    file = Path(name)
    return file.name.startswith("libpython") or (file.is_file() and file.samefile(sys.executable))


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
    """The counters to which an instruction with this mnemonic adds, apart from memory accesses."""
    name = mnemonic.lower()
    return next((counters for pattern, counters in _PATTERNS if re.match(pattern, name)), ())


def read_profile(lines: Iterable[str]) -> dict[str, Counter[int]]:
    """By object and address, how often the instruction was executed.

    `lines` are a callgrind profile written with --dump-instr=yes and neither strings nor positions compressed.
    """
    executed: dict[str, Counter[int]] = {}
    current: Counter[int] = Counter()
    inclusive = False
    for line in lines:
        if line.startswith("ob="):
            current = executed.setdefault(line[3:].strip(), Counter())
        elif line.startswith("calls="):
            inclusive = True  # the next cost is that of the called function, which is counted in its own place
        elif line.startswith("0x"):
            fields = line.split()
            if not inclusive and len(fields) > 2:
                current[int(fields[0], 16)] += int(fields[2])
            inclusive = False
    return executed


def reassign_to_owners(
    objects: dict[str, Counter[int]], code: dict[str, list[tuple[int, bytes]]]
) -> dict[str, Counter[int]]:
    """The profile, with addresses outside the code of their object reassigned to the object that owns them.

    After a jump, rather than a call, from one library into another, callgrind still reports the first. The owner is
    recognised by having executed the same address itself.
    """
    counts = {name: Counter[int]() for name in objects}
    for name, addresses in objects.items():
        for address, times in addresses.items():
            owner = name
            if not _covers(code[name], address):
                others = (other for other in objects if address in objects[other] and _covers(code[other], address))
                owner = next(others, name)
            counts[owner][address] += times
    return counts


def _covers(code: list[tuple[int, bytes]], address: int) -> bool:
    return any(0 <= address - start < len(text) for start, text in code)


def classify(executed: Counter[int], code: list[tuple[int, bytes]]) -> tuple[OperationCounts, int]:
    """Counts of executed instructions, and how many lie outside `code`, which is (address, bytes) pieces."""
    import iced_x86  # an optional extra

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
    from elftools.elf.elffile import ELFFile  # an optional extra

    with file.open("rb") as stream:
        segments = ELFFile(stream).iter_segments("PT_LOAD")
        return [(segment["p_vaddr"], segment.data()) for segment in segments if segment["p_flags"] & 1]
