"""Beside each file of bitstreams: with which code of the codec they were encoded, which nothing in them tells."""

from __future__ import annotations

import json
from pathlib import Path

from codecbench.core.engine.identity import digest, json_from_bytes
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.plain_file import read_plain
from codecbench.core.engine.text import clean_line


class EncoderNotes:
    """The notes in a folder of bitstreams, by the id of their coding job."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[str, str] = {}

    def write(self, job_id: str, code: str) -> None:
        """Note the codec's code, as `code_of` gives it, of bitstreams that were just written."""
        body = {"job": job_id, "code": code}
        write_file(self._path(job_id), json.dumps({"checksum": digest(body), **body}).encode() + b"\n")
        self._known[job_id] = code

    def read(self, job_id: str) -> str:
        """The code that wrote a job's bitstreams; empty where nobody knows, or the note is damaged."""
        if job_id not in self._known:
            self._known[job_id] = self._read(job_id)
        return self._known[job_id]

    def damaged(self, job_id: str) -> bool:
        """Whether there is a note of a job's bitstreams that cannot be read."""
        return not self.read(job_id) and self._path(job_id).exists()

    def _read(self, job_id: str) -> str:
        try:
            document = json_from_bytes(read_plain(self._path(job_id)))
            body = {"job": job_id, "code": document["code"]}
            return clean_line(document["code"]) if digest(body) == document["checksum"] else ""
        except (OSError, ValueError, KeyError, TypeError):
            return ""

    def _path(self, job_id: str) -> Path:
        return self._folder / f"{job_id}.code"
