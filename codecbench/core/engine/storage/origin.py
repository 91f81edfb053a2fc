"""Where a run folder was made: here, which its plan can prove, or elsewhere.

A plan carries a seal that takes a key of the user's own, so that nobody else can claim the paths in it are ours.
"""

from __future__ import annotations

import getpass
import hashlib
import hmac
import os
import secrets
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from codecbench.core.engine.identity import canonical_json
from codecbench.core.engine.storage.plain_file import open_plain
from codecbench.core.kernels.folders import cache_folder

_KEY_FILE: Final = "origin.key"
_KEY_BYTES: Final = 32


def origin_here(plan_digest: str, folder: Path) -> dict[str, Any]:
    """Host, user and path, and the seal that proves them; the seal is None where no key can be kept."""
    origin = {"host": socket.gethostname(), "user": _user(), "path": str(folder.absolute())}
    return {**origin, "seal": _seal(plan_digest, origin, _key(make=True))}


def is_from_here(plan_digest: str, origin: dict[str, Any]) -> bool:
    """Whether the plan of this digest was sealed with this user's key."""
    content = {name: value for name, value in origin.items() if name != "seal"}
    expected = _seal(plan_digest, content, _key(make=False))
    return expected is not None and hmac.compare_digest(expected.encode(), str(origin.get("seal")).encode())


def _seal(plan_digest: str, origin: dict[str, Any], key: bytes | None) -> str | None:
    if key is None:
        return None
    return hmac.new(key, canonical_json([plan_digest, origin]), hashlib.sha256).hexdigest()


def _key(make: bool) -> bytes | None:
    """This user's key; None where there is none, or others could have read it."""
    path = cache_folder() / _KEY_FILE
    if make:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
            with os.fdopen(handle, "wb") as stream:
                stream.write(secrets.token_bytes(_KEY_BYTES))
    try:
        with open_plain(path) as stream:
            facts = os.fstat(stream.fileno())
            key = stream.read()
    except OSError:
        return None
    private = facts.st_uid == os.getuid() and not facts.st_mode & 0o077
    return key if private and len(key) == _KEY_BYTES else None


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
