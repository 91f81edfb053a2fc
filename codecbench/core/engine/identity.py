"""Identities: equal things get equal names, over processes, machines and years."""

from __future__ import annotations

import hashlib
import json
from typing import Any

_DIGEST_BYTES = 16


def digest(value: Any) -> str:
    """A 32-character hex digest of a JSON value; the order of mappings does not matter.

    Raises TypeError for what JSON cannot hold and ValueError for NaN and infinities, which have no
    agreed spelling.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=_DIGEST_BYTES).hexdigest()


def seed_from(identity: str, seed: int) -> int:
    """A 63-bit seed for one cell: the run's seed mixed with the cell's identity, so that no two cells share one."""
    return int(digest([identity, seed])[:16], 16) >> 1
