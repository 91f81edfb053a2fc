"""Where the bytes of a bitstream go, of either profile."""

from __future__ import annotations

from dataclasses import dataclass

from codecbench.plugins.codecs.multilevel.bitstream import unpack, version_of
from codecbench.plugins.codecs.multilevel.context import bitstream as context
from codecbench.plugins.codecs.multilevel.header import CONTEXT_VERSION


@dataclass(frozen=True)
class Sizes:
    """Where the bytes of a bitstream go. header: fixed fields, custom table, section sizes, checksum."""

    header: int
    tables: tuple[int, ...]
    keys: tuple[int, ...]
    payload: int
    entries: tuple[int, ...]

    @property
    def total(self) -> int:
        return self.header + sum(self.tables) + sum(self.keys) + self.payload


def describe(bitstream: bytes) -> Sizes:
    """Bytes of header, tables and keys by level, and payload; raises BitstreamError as decoding would."""
    if version_of(bitstream) == CONTEXT_VERSION:
        payload = sum(map(len, context.unpack(bitstream)[1]))
        return Sizes(len(bitstream) - payload, (), (), payload, ())
    parts = unpack(bitstream)
    tables = tuple(len(level.table) for level in parts.levels)
    keys = tuple(level.keys.nbytes for level in parts.levels)
    header = len(bitstream) - sum(tables) - sum(keys) - len(parts.payload)
    return Sizes(header, tables, keys, len(parts.payload), tuple(level.entries for level in parts.levels))
