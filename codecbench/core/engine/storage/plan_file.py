"""The plan of a run folder, the matrix beside it, and proof of where they were made.

A plan carries a seal made with a key of the user, so that nobody else can claim that the paths in it are the user's.
"""

from __future__ import annotations

import getpass
import hashlib
import hmac
import logging
import os
import secrets
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import canonical_json, digest, json_from_bytes
from codecbench.core.engine.planning.model import Plan, plan_from_json
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.plain_file import open_plain, read_plain
from codecbench.core.engine.text import clean_line, clean_text
from codecbench.core.kernels.folders import cache_folder

_KEY_FILE: Final = "origin.key"
_KEY_BYTES: Final = 32


def origin_here(plan_digest: str, folder: Path) -> dict[str, Any]:
    """Return host, user and path with their seal; the seal is None if no key can be stored."""
    origin = {"host": socket.gethostname(), "user": _user(), "path": str(folder.absolute())}
    return {**origin, "seal": _seal(plan_digest, origin, _key(make=True))}


def is_from_here(plan_digest: str, origin: dict[str, Any]) -> bool:
    """Whether the plan with this digest was sealed with this user's key."""
    content = {name: value for name, value in origin.items() if name != "seal"}
    expected = _seal(plan_digest, content, _key(make=False))
    return expected is not None and hmac.compare_digest(expected.encode(), str(origin.get("seal")).encode())


def _seal(plan_digest: str, origin: dict[str, Any], key: bytes | None) -> str | None:
    if key is None:
        return None
    return hmac.new(key, canonical_json([plan_digest, origin]), hashlib.sha256).hexdigest()


def _key(make: bool) -> bytes | None:
    """Return this user's key; None if there is none, or if others could have read it."""
    path = cache_folder() / _KEY_FILE
    if make:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
            with os.fdopen(handle, "wb") as stream:
                stream.write(secrets.token_bytes(_KEY_BYTES))
    try:
        with open_plain(path) as stream:
            status = os.fstat(stream.fileno())
            key = stream.read()
    except OSError:
        return None
    private = status.st_uid == os.getuid() and not status.st_mode & 0o077
    return key if private and len(key) == _KEY_BYTES else None


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


log = logging.getLogger("codecbench.store")


class PlanFile:
    """`plan.json` of a run folder, with a checksum, and `matrix.yaml`, the text that the plan was made from."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._path = folder / "plan.json"
        self._matrix_path = folder / "matrix.yaml"

    def write(self, plan: Plan) -> None:
        """Write the plan and its matrix. Raises OSError."""
        body = plan.as_json()
        content = {"plan": body, "origin": origin_here(digest(body), self.folder)}
        write_file(self._matrix_path, plan.matrix_text.encode(), durable=True)
        write_file(self._path, canonical_json({"checksum": digest(content), **content}), durable=True)

    def read(self) -> Plan:
        """Return the plan; log a warning if the matrix is damaged.

        Raises StoreError if the plan is missing or damaged.
        """
        try:
            plan = plan_from_json(self._document()["plan"])
        except FileNotFoundError:
            raise StoreError(f"{self.folder} is not a run folder: it has no plan.json") from None
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            reason = clean_line(str(error))
            message = f"{self._path} is damaged ({reason}); run the matrix again, which computes only what is missing"
            raise StoreError(message) from error
        self._compare_matrix(plan)
        return plan

    def portable(self) -> tuple[bytes, bytes]:
        """Return the matrix, and the plan without its origin and seal, for others to keep.

        Raises OSError, ValueError, KeyError or TypeError if the plan cannot be read.
        """
        body = self._document()["plan"]
        return body["matrix_text"].encode(), canonical_json({"checksum": digest(body), "plan": body})

    def origin_elsewhere(self) -> str | None:
        """Describe where the plan was made, or return None if it was made here.

        Raises OSError, ValueError, KeyError or TypeError if it cannot be read.
        """
        document = self._document()
        origin = document.get("origin")
        if not isinstance(origin, dict):
            return "an unknown place"
        if is_from_here(digest(document["plan"]), origin):
            return None
        return clean_line(f"{origin.get('path')} on {origin.get('host')} by {origin.get('user')}")

    def _document(self) -> dict[str, Any]:
        """Return the content of plan.json. Raises ValueError, KeyError or TypeError if its checksum is wrong."""
        document: dict[str, Any] = json_from_bytes(read_plain(self._path))
        sealed = {"plan": document["plan"], "origin": document["origin"]} if "origin" in document else document["plan"]
        if digest(sealed) != document["checksum"]:
            raise ValueError("its checksum does not match its content")
        return document

    def _compare_matrix(self, plan: Plan) -> None:
        """Log a warning if the copy of the matrix is not what the plan was made from."""
        with suppress(OSError):
            if clean_text(read_plain(self._matrix_path).decode(errors="replace")) == plan.matrix_text:
                return
        message = "%s is missing or not the matrix of the plan; the next run writes it again"
        log.warning(message, self._matrix_path)
