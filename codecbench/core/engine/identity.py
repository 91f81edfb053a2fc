"""Identities: equal values get equal digests across processes, machines and years."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any, NoReturn

DIGEST_BYTES = 16


def canonical_json(value: Any) -> bytes:
    """Return the canonical spelling of a JSON value; the order of mappings does not matter.

    Raises TypeError for values that JSON cannot represent, and ValueError for NaN and infinities, which have no
    standard spelling.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def json_from_bytes(content: bytes | str) -> Any:
    """Parse a JSON text. Raises ValueError for anything else, including NaN, infinities and too deep nesting."""
    try:
        return json.loads(content, parse_constant=_no_number, parse_float=_finite)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def content_digest(content: bytes) -> str:
    """Return a 32-character hex digest of bytes."""
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).hexdigest()


def digest(value: Any) -> str:
    """Return the digest of a JSON value in its canonical spelling."""
    return content_digest(canonical_json(value))


def seed_from(identity: str, seed: int) -> int:
    """Return a 63-bit seed for one cell: the run's seed mixed with the cell's identity, so that cells differ."""
    return int(digest([identity, seed])[:16], 16) >> 1


def _no_number(literal: str) -> NoReturn:
    raise ValueError(f"{literal} is not a JSON number")


def _finite(literal: str) -> float:
    value = float(literal)
    return value if math.isfinite(value) else _no_number(literal)
