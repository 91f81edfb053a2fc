"""Entropy coder of a bitstream's tables and payload."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError, KeyCollision, ParamsError
from codecbench.core.counting.trace import Trace
from codecbench.plugins.codecs.multilevel.arithmetic import decode_symbols, encode_symbols
from codecbench.plugins.codecs.multilevel.bitstream import Bitstream, Level, check_end, pad_section
from codecbench.plugins.codecs.multilevel.header import Header
from codecbench.plugins.codecs.multilevel.keys import (
    FREE_PRUNED_TESTS,
    MANUAL_BITS,
    MAX_CODE,
    MAX_SEQUENTIAL_TESTS,
    PRUNED_TESTS_PER_BYTE,
    Keys,
    Search,
    colliding_digits,
    greedy_search,
    is_super_increasing,
    pruned_search,
    sequential_search,
)
from codecbench.plugins.codecs.multilevel.levels import LevelTable, MinimizedIndices
from codecbench.plugins.codecs.multilevel.rice import decode_ordered_tuples, encode_ordered_tuples
from codecbench.plugins.codecs.multilevel.tables import (
    BAD_COUNTS,
    OUT_OF_RANGE,
    OVERRUN,
    REPEATED,
    decode_codes,
    decode_tuples,
    encode_codes,
    encode_tuples,
)

_REASONS = {
    OVERRUN: "truncated",
    OUT_OF_RANGE: "a digit or code is out of range",
    BAD_COUNTS: "counts do not sum to the number of groups",
    REPEATED: "an entry occurs twice",
}
_NO_COUNTS = np.zeros(0, np.int64)


def encode(header: Header, minimized: MinimizedIndices, trace: Trace) -> Bitstream:
    """Encode the parts of a bitstream. Raises KeyCollision in search mode if any two tuples share a code."""
    header = replace(header, offset=minimized.offset, radix=minimized.tables[0].radix)
    levels = []
    for number, table in enumerate(minimized.tables, start=1):
        counts = table.counts if number == header.levels else _NO_COUNTS
        data = pad_section(_encode_table(table, counts, header, trace), len(table.codes))
        if header.search:
            _check_searchable(table, len(data), number)
        levels.append(Level(len(table.codes), data, table.keys if header.search else _NO_COUNTS))
    counts = minimized.tables[-1].counts
    out = np.empty(4 * len(minimized.ranks) + 16, np.uint8)
    with trace.stage("arithmetic_coding") as run:
        size = run(encode_symbols, minimized.ranks, counts, np.empty(len(counts) + 1, np.int64), out)
    return Bitstream(header, levels, pad_section(out[:size].tobytes(), header.samples))


def _encode_table(table: LevelTable, counts: NDArray[np.int64], header: Header, trace: Trace) -> bytes:
    room = 4096 + 8 * table.tuples.size
    with trace.stage("table_coding") as run:
        while True:
            out = np.empty(room, np.uint8)
            if header.search:
                size = run(encode_codes, table.codes, counts, out)
            elif header.rice:
                size = run(encode_ordered_tuples, table.tuples, counts, table.filler, out)
            else:
                size = run(encode_tuples, table.tuples, counts, out)
            if size >= 0:
                return out[:size].tobytes()
            room *= 4


def _check_searchable(table: LevelTable, size: int, level: int) -> None:
    pair = colliding_digits(table.keys, table.radix)
    if pair is not None:
        raise KeyCollision(
            f"level {level}: the digits {pair[0]} and {pair[1]} get the same code under these keys, so a search "
            f"cannot distinguish them; set `keys: canonical` or `decoding: header`"
        )
    if not _is_affordable(table.keys, table.radix, len(table.codes), size):
        raise ParamsError(
            f"level {level}: {len(table.codes)} codes of digits 0..{table.radix - 1} take too long to search under "
            f"keys that are not super-increasing; set `keys: canonical` or `decoding: header`"
        )


def _is_affordable(keys: Keys, radix: int, entries: int, size: int) -> bool:
    """Whether searching a table of so many bytes is cheap enough for a decoder."""
    tests: int = entries * radix ** (len(keys) - 1)
    return is_super_increasing(keys, radix) or tests <= FREE_PRUNED_TESTS + PRUNED_TESTS_PER_BYTE * size


def decode(parts: Bitstream, search: Search, trace: Trace) -> tuple[NDArray[np.int32], list[NDArray[np.int32]]]:
    """Decode the last level's ranks and the tuples of every level.

    Every rank is within its table and every digit within its alphabet; else raises BitstreamError with the reason.
    """
    header = parts.header
    groups, radix = header.samples, header.radix
    tuples = []
    counts = _NO_COUNTS
    for number, level in enumerate(parts.levels, start=1):
        groups = -(-groups // header.group)
        counts = np.empty(level.entries if number == header.levels else 0, np.int64)
        if header.search:
            tuples.append(_search_tuples(level, number, radix, groups, counts, search, trace))
        else:
            tuples.append(_decode_tuples(level, number, radix, groups, counts, header, trace))
        radix = level.entries
    ranks = np.empty(groups, np.int32)
    with trace.stage("arithmetic_decoding") as run:
        data = np.frombuffer(parts.payload, np.uint8)
        read = run(decode_symbols, data, counts, np.empty(len(counts) + 1, np.int64), ranks)
    if read < 0:
        raise BitstreamError("payload: the histogram of its symbols differs from the counts")
    check_end(parts.payload, read, header.samples, "payload")
    return ranks, tuples


def _decode_tuples(
    level: Level, number: int, radix: int, groups: int, counts: NDArray[np.int64], header: Header, trace: Trace
) -> NDArray[np.int32]:
    tuples = np.empty((level.entries, header.group), np.int32)
    data = np.frombuffer(level.table, np.uint8)
    with trace.stage("table_decoding") as run:
        if header.rice:
            usual = -header.offset if number == 1 else 0
            read = run(decode_ordered_tuples, data, radix, groups, usual, tuples, counts)
        else:
            read = run(decode_tuples, data, radix, groups, tuples, counts)
    _check_table(level, read, number)
    return tuples


def _search_tuples(
    level: Level, number: int, radix: int, groups: int, counts: NDArray[np.int64], search: Search, trace: Trace
) -> NDArray[np.int32]:
    _check_keys(level, number, radix)
    largest = sum(level.keys.tolist()) * (radix - 1)
    codes = np.empty(level.entries, np.int64)
    with trace.stage("table_decoding") as run:
        read = run(decode_codes, np.frombuffer(level.table, np.uint8), largest, groups, codes, counts)
    _check_table(level, read, number)
    tuples = np.empty((level.entries, len(level.keys)), np.int32)
    if not _search(codes, level.keys, radix, tuples, search, trace):
        raise BitstreamError(f"level {number}: a code belongs to no tuple under the keys")
    return tuples


def _check_keys(level: Level, number: int, radix: int) -> None:
    """Raise BitstreamError for keys under which a search is ambiguous, overflows or takes too long."""
    keys: list[int] = level.keys.tolist()
    if sum(keys) * (radix - 1) > MAX_CODE:
        raise BitstreamError(f"level {number}: codes exceed 62 bits")
    if is_super_increasing(level.keys, radix):
        return
    if max(keys) > 1 << MANUAL_BITS or not _is_affordable(level.keys, radix, level.entries, len(level.table)):
        raise BitstreamError(f"level {number}: keys {keys} are not super-increasing and too costly to search")
    try:
        pair = colliding_digits(level.keys, radix)
    except ParamsError as error:
        raise BitstreamError(f"level {number}: {error}") from error
    if pair is not None:
        raise BitstreamError(f"level {number}: keys are not one-to-one: {pair[0]} and {pair[1]} get the same code")


def _search(
    codes: NDArray[np.int64], keys: Keys, radix: int, tuples: NDArray[np.int32], search: Search, trace: Trace
) -> Any:
    order = np.argsort(keys, kind="stable")
    if search == "greedy" and not is_super_increasing(keys, radix):
        search = "pruned"
    if search == "sequential" and len(codes) * radix ** len(keys) > MAX_SEQUENTIAL_TESTS:
        raise ParamsError(
            f"a sequential search of {len(codes)} codes over {radix}^{len(keys)} tuples takes too long; "
            f"set `search: pruned` or `greedy`"
        )
    with trace.stage(f"{search}_search") as run:
        if search == "sequential":
            return run(sequential_search, codes, keys, radix, tuples)
        return run(greedy_search if search == "greedy" else pruned_search, codes, keys, order, radix, tuples)


def _check_table(level: Level, read: int, number: int) -> None:
    if read < 0:
        raise BitstreamError(f"table of level {number}: {_REASONS[read]}")
    check_end(level.table, read, level.entries, f"table of level {number}")
