"""Identities: equal things get equal names, over processes, machines and years."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any, NoReturn

DIGEST_BYTES = 16


def canonical_json(value: Any) -> bytes:
    """The one spelling of a JSON value; the order of mappings does not matter.

    Raises TypeError for what JSON cannot hold and ValueError for NaN and infinities, which have no
    agreed spelling.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def json_from_bytes(content: bytes | str) -> Any:
    """The value of a JSON text. Raises ValueError for anything else: NaN, infinities and bottomless nesting too."""
    try:
        return json.loads(content, parse_constant=_no_number, parse_float=_finite)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def content_digest(content: bytes) -> str:
    """A 32-character hex digest of bytes."""
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).hexdigest()


def digest(value: Any) -> str:
    """The digest of a JSON value in its canonical spelling."""
    return content_digest(canonical_json(value))


def seed_from(identity: str, seed: int) -> int:
    """A 63-bit seed for one cell: the run's seed mixed with the cell's identity, so that no two cells share one."""
    return int(digest([identity, seed])[:16], 16) >> 1


def _no_number(literal: str) -> NoReturn:
    raise ValueError(f"{literal} is not a number that JSON knows")


def _finite(literal: str) -> float:
    value = float(literal)
    return value if math.isfinite(value) else _no_number(literal)
