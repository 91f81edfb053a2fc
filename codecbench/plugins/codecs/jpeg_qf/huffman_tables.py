"""Huffman tables: specification, codes, and optimal tables for an image (ITU-T T.81 annexes C, F, K)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.counting.kernel import kernel

MAX_LENGTH = 16
LOOKAHEAD = 8
"""Longest code in bits that one look-up decodes."""


@dataclass(frozen=True)
class HuffmanTable:
    """A table as in DHT."""

    lengths: bytes
    """Number of codes of each length 1..16."""
    symbols: bytes
    """Symbols in code order."""

    def __post_init__(self) -> None:
        if len(self.lengths) != MAX_LENGTH or sum(self.lengths) != len(self.symbols):
            raise BitstreamError(f"jpeg_qf: a Huffman table of lengths {list(self.lengths)} is inconsistent")
        code = 0
        for length, count in enumerate(self.lengths, 1):
            code += count
            if code > 1 << length:
                raise BitstreamError(f"jpeg_qf: too many codes of {length} bits")
            code <<= 1
        if len(set(self.symbols)) != len(self.symbols):
            raise BitstreamError("jpeg_qf: a Huffman table codes a symbol twice")


@dataclass(frozen=True)
class EncodingTables:
    """Code and length by class (0 DC, 1 AC), table and symbol; length 0 if a symbol has no code."""

    codes: NDArray[np.uint32]
    lengths: NDArray[np.uint8]


@dataclass(frozen=True)
class DecodingTables:
    """Look-up tables of the decoder, by class and table (T.81 F.2.2.3)."""

    lookahead: NDArray[np.uint16]
    """By the next 8 bits: length << 8 | symbol, 0 for longer codes."""
    max_codes: NDArray[np.int32]
    """By length: the largest code, -1 for none."""
    offsets: NDArray[np.int32]
    """By length: the index of a code's symbol minus the code."""
    symbols: NDArray[np.uint8]


def encoding_tables(tables: dict[tuple[int, int], HuffmanTable]) -> EncodingTables:
    """Assign canonical codes (T.81 annex C) to tables keyed by class and destination 0..1."""
    codes = np.zeros((2, 2, 256), np.uint32)
    lengths = np.zeros((2, 2, 256), np.uint8)
    for (kind, destination), table in tables.items():
        for symbol, code, length in _canonical_codes(table):
            codes[kind, destination, symbol] = code
            lengths[kind, destination, symbol] = length
    return EncodingTables(codes, lengths)


def decoding_tables(tables: dict[tuple[int, int], HuffmanTable]) -> DecodingTables:
    """Build the look-up tables of the decoding kernel for tables keyed by class and destination 0..3."""
    lookahead = np.zeros((2, 4, 1 << LOOKAHEAD), np.uint16)
    max_codes = np.full((2, 4, MAX_LENGTH + 1), -1, np.int32)
    offsets = np.zeros((2, 4, MAX_LENGTH + 1), np.int32)
    symbols = np.zeros((2, 4, 256), np.uint8)
    for key, table in tables.items():
        symbols[key][: len(table.symbols)] = list(table.symbols)
        for index, (symbol, code, length) in enumerate(_canonical_codes(table)):
            max_codes[key][length] = code
            offsets[key][length] = index - code
            if length <= LOOKAHEAD:
                spare = LOOKAHEAD - length
                lookahead[key][code << spare : (code + 1) << spare] = length << 8 | symbol
    return DecodingTables(lookahead, max_codes, offsets, symbols)


def _canonical_codes(table: HuffmanTable) -> list[tuple[int, int, int]]:
    """List (symbol, code, length) of every symbol in code order."""
    codes, code, index = [], 0, 0
    for length, count in enumerate(table.lengths, 1):
        for _ in range(count):
            codes.append((table.symbols[index], code, length))
            code, index = code + 1, index + 1
        code <<= 1
    return codes


def optimal_table(frequencies: NDArray[np.int64], run: Any) -> HuffmanTable:
    """Make the table that codes symbols of these (256,) frequencies in the fewest bits, with codes of at most 16."""
    lengths = np.zeros(MAX_LENGTH, np.uint8)
    symbols = np.zeros(256, np.uint8)
    count = run(optimal_code, np.append(frequencies, 1), lengths, symbols)
    return HuffmanTable(lengths.tobytes(), symbols[:count].tobytes())


@kernel
def optimal_code(frequencies, lengths, symbols):  # type: ignore[no-untyped-def]
    """Compute code lengths for (257,) frequencies (T.81 K.2); returns how many symbols have a code.

    The last frequency is the reserved point of figure K.1, which keeps a code of all ones from being used.
    Fills `lengths` (16,) with how many codes there are of each length, and `symbols` in code order.
    """
    sizes = np.zeros(257, np.int64)
    others = np.full(257, -1, np.int64)
    while True:  # figure K.1: merge the two least frequent, of equals the last
        first, second = -1, -1
        for v in range(257):
            if frequencies[v] == 0:
                continue
            if first < 0 or frequencies[v] <= frequencies[first]:
                first, second = v, first
            elif second < 0 or frequencies[v] <= frequencies[second]:
                second = v
        if second < 0:
            break
        frequencies[first] += frequencies[second]
        frequencies[second] = 0
        sizes[first] += 1
        while others[first] >= 0:
            first = others[first]
            sizes[first] += 1
        others[first] = second
        sizes[second] += 1
        while others[second] >= 0:
            second = others[second]
            sizes[second] += 1
    counts = np.zeros(258, np.int64)
    for v in range(257):
        if sizes[v] > 0:
            counts[sizes[v]] += 1
    limit_lengths(counts)
    for length in range(1, 17):
        lengths[length - 1] = counts[length]
    coded = 0
    for size in range(1, 258):  # figure K.4
        for v in range(256):
            if sizes[v] == size:
                symbols[coded] = v
                coded += 1
    return coded


@kernel
def limit_lengths(counts):  # type: ignore[no-untyped-def]
    """Shorten codes to 16 bits and remove the reserved one (T.81 figure K.3). `counts` is by length, (258,)."""
    for length in range(257, 16, -1):
        while counts[length] > 0:
            shorter = length - 2
            while counts[shorter] == 0:
                shorter -= 1
            counts[length] -= 2
            counts[length - 1] += 1
            counts[shorter + 1] += 2
            counts[shorter] -= 1
    longest = 16
    while counts[longest] == 0:
        longest -= 1
    counts[longest] -= 1


def _table(lengths: str, symbols: bytes) -> HuffmanTable:
    return HuffmanTable(bytes(map(int, lengths.split())), symbols)


STANDARD_TABLES: dict[tuple[int, int], HuffmanTable] = {
    (0, 0): _table("0 1 5 1 1 1 1 1 1 0 0 0 0 0 0 0", bytes(range(12))),
    (0, 1): _table("0 3 1 1 1 1 1 1 1 1 1 0 0 0 0 0", bytes(range(12))),
    (1, 0): _table(
        "0 2 1 3 3 2 4 3 5 5 4 4 0 0 1 125",
        bytes.fromhex(
            "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728"
            "292a3435363738393a434445464748494a535455565758595a636465666768696a737475767778797a83848586878889"
            "8a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2"
            "e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
        ),
    ),
    (1, 1): _table(
        "0 2 1 2 4 4 3 4 7 5 4 4 0 1 2 119",
        bytes.fromhex(
            "000102031104052131061241510761711322328108144291a1b1c109233352f0156272d10a162434e125f11718191a26"
            "2728292a35363738393a434445464748494a535455565758595a636465666768696a737475767778797a828384858687"
            "88898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9da"
            "e2e3e4e5e6e7e8e9eaf2f3f4f5f6f7f8f9fa"
        ),
    ),
}
"""Tables K.3 to K.6, which other encoders use too; keyed by class and destination (0 luminance, 1 chrominance)."""
