"""The files that say what machines and versions a run was computed on, one an environment, each checked by its name."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

from codecbench.core.engine.identity import digest, json_from_bytes
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.environment import environment_id
from codecbench.core.engine.storage.plain_file import read_plain
from codecbench.core.engine.text import clean_line, clean_value

log = logging.getLogger("codecbench.store")


class EnvironmentFiles:
    """The descriptions in a folder, by the id of their environment."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._sound: set[str] = set()

    def write(self, name: str, description: dict[str, Any]) -> None:
        """Keep the description of the environment of this id, unless it is there and sound."""
        if name in self._sound:
            return
        path = self._path(name)
        try:
            _description(name, read_plain(path))
        except (OSError, ValueError):
            body = {"id": name, "environment": description}
            document = {"checksum": digest(body), **body}
            write_file(path, json.dumps(document, indent=1, allow_nan=False).encode() + b"\n", durable=True)
        self._sound.add(name)

    def read(self) -> dict[str, dict[str, Any]]:
        """All that are sound, their texts fit to be shown; of the others the log has a line each."""
        found, damaged = self._read()
        for name, reason in damaged.items():
            log.warning("%s is damaged (%s); what it said is left out", self._path(name), reason)
        return found

    def damaged(self) -> dict[str, str]:
        """Why some cannot be relied on."""
        return self._read()[1]

    def _read(self) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
        found: dict[str, dict[str, Any]] = {}
        damaged: dict[str, str] = {}
        for path in sorted(self.folder.glob("*.json")):
            try:
                found[path.stem] = clean_value(_description(path.stem, read_plain(path)))
            except (OSError, ValueError) as error:
                damaged[path.stem] = clean_line(str(error))
        return found, damaged

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"


def _description(name: str, content: bytes) -> dict[str, Any]:
    """The description in the file of an environment. Raises ValueError where it is damaged or that of another one."""
    document = json_from_bytes(content)
    if not isinstance(document, dict):
        raise ValueError("it is not the description of an environment")
    description = document
    if document.keys() == {"checksum", "id", "environment"}:
        description = document["environment"]
        if digest({"id": document["id"], "environment": description}) != document["checksum"]:
            raise ValueError("its checksum does not match its content")
        if document["id"] != name:
            raise ValueError(f"it describes environment {document['id']}")
    elif environment_id(document) != name:  # without a checksum, as earlier versions wrote it
        raise ValueError("its content does not match its name")
    if not isinstance(description, dict) or not all(
        isinstance(description.get(part, {}), dict) for part in ("machine", "volatile")
    ):
        raise ValueError("it is not the description of an environment")
    return description
