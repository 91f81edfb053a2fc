"""A run folder: what is where, who may write, and what is still sound.

    matrix.yaml  plan.json  environment/<id>.json  coded/<job>  records/<xx>/<cell>/record.json
    records/index.jsonl  tables/  report/  run.log  lock

Every file is written whole and renamed. A record is one folder (record.json, frames.parquet, artifacts) that
is renamed into place whole, so it is complete or absent. Every file says what it belongs to and carries a checksum:
damage is found, reported, and made again by the next run. Links that lead out of the folder are refused.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import content_digest
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.storage import folder_lock
from codecbench.core.engine.storage.atomic import (
    make_folder,
    remove_folder,
    sweep,
    sync_file_system,
    write_file,
    write_folder,
)
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile, EncoderNotes
from codecbench.core.engine.storage.environment import EnvironmentFiles
from codecbench.core.engine.storage.plain_file import read_plain, refuse_links
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.record import (
    RECORD_FILE,
    SAMPLES_FILE,
    Record,
    RecordDamage,
    bytes_from_record,
    record_from_bytes,
)
from codecbench.core.engine.storage.record_index import IndexEntry, RecordIndex, entry_from_record

log = logging.getLogger("codecbench.store")

_DEPTH: Final = 3
"""Levels of a run folder on which it has files and folders of its own: `records/ab/<cell>`."""

_DURABLE_FROM_S: Final = 1.0
"""A record of a cell that took longer is waited for until the disk has it; the disk has quicker ones, which are cheaper
to compute again, when the run ends."""


class Store:
    """The files of one run. Reading needs nothing; writing needs `locked`, which only one process can hold."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.records_folder = folder / "records"
        self.coded_folder = folder / "coded"
        self.log_path = folder / "run.log"
        self._index = RecordIndex(self.records_folder / "index.jsonl")
        self.encoders = EncoderNotes(self.coded_folder)
        self.environments = EnvironmentFiles(folder / "environment")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for writing. Raises StoreError where another process does, or a link leads out of it.

        When it is given back, the disk has all that was written.
        """
        with ExitStack() as stack:
            with self._writing():
                make_folder(self.folder, durable=True)
                self.refuse_links()
                stack.enter_context(folder_lock.hold_lock(self.folder / "lock"))
                self._tidy()
            yield
            with self._writing():
                sync_file_system(self.folder)

    def refuse_links(self) -> None:
        """Raise StoreError where a file or folder of the run is a link that leads out of its folder."""
        refuse_links(self.folder, _DEPTH)

    def in_use(self) -> bool:
        """Whether a process is writing to this folder now."""
        return folder_lock.is_locked(self.folder / "lock")

    def write_plan(self, plan: Plan) -> None:
        """Keep the plan and the matrix that it was made of. Raises StoreError where that cannot be written."""
        with self._writing():
            PlanFile(self.folder).write(plan)

    def read_plan(self) -> Plan:
        """The plan of the last run in this folder.

        Raises StoreError where it is missing or damaged, or the folder has links that lead out of it.
        """
        self.refuse_links()
        return PlanFile(self.folder).read()

    def coded_path(self, job_id: str) -> Path:
        return self.coded_folder / f"{job_id}.bits"

    def has_coded(self, job_id: str, frames: int) -> bool:
        """Whether a sound file of this job's bitstreams is here; a damaged one is reported and removed."""
        path = self.coded_path(job_id)
        if not path.exists():
            return False
        try:
            whole = len(BitstreamFile(path, job_id)) == frames
            if whole and not self.encoders.damaged(job_id):
                return True
            reason = "its note of who encoded it is damaged" if whole else "it has another number of frames"
        except BitstreamDamage as error:
            reason = str(error)
        self.drop_coded(job_id, reason)
        return False

    def write_coded(self, job_id: str, content: bytes) -> None:
        """Keep a file of bitstreams that came from a worker which does not see this folder."""
        with self._writing():
            write_file(self.coded_path(job_id), content)

    def note_encoder(self, job_id: str, code: str) -> None:
        """Keep with which code of its codec a job's bitstreams were encoded."""
        with self._writing():
            self.encoders.write(job_id, code)

    def drop_coded(self, job_id: str, reason: str) -> None:
        """Remove a file of bitstreams, so that the sequence is encoded again when they are needed."""
        log.warning("coded/%s.bits will be encoded again: %s", job_id, reason)
        with self._writing():
            self.coded_path(job_id).unlink(missing_ok=True)

    def record_folder(self, cell_id: str) -> Path:
        return Path(f"{self.records_folder}/{cell_id[:2]}/{cell_id}")

    def write_record(self, record: Record) -> Record:
        """Keep a record with its contents, in place of an earlier one, and return it without them.

        Raises StoreError where that cannot be written (disk full), and then changes nothing.
        """
        contents, description = record.contents, record.environment_description
        files = {name: {"size": len(data), "digest": content_digest(data)} for name, data in contents.items()}
        record = replace(record, files=files, contents={}, environment_description={})
        content = bytes_from_record(record)
        durable = record.duration_s >= _DURABLE_FROM_S
        with self._writing():
            if record.environment is not None:
                self.environments.write(record.environment, description)
            write_folder(self.record_folder(record.cell_id), {**contents, RECORD_FILE: content}, durable=durable)
            self._index.append(entry_from_record(record, content))
        return record

    def read_record(self, cell_id: str, entry: IndexEntry | None = None) -> Record:
        """The record of a cell, checked. Raises RecordDamage, or StoreError if there is none.

        entry: what the index knows of it; a record that has its digest is not checked a second time.
        """
        path = f"{self.records_folder}/{cell_id[:2]}/{cell_id}/{RECORD_FILE}"
        try:
            content = read_plain(path)
            indexed = entry is not None and content_digest(content) == entry.digests[RECORD_FILE]
            record = record_from_bytes(content, known_good=indexed)
        except FileNotFoundError:
            raise StoreError(f"{self.folder} has no record of cell {cell_id}") from None
        except (RecordDamage, OSError) as error:
            raise RecordDamage(f"{path}: {error}") from error
        if record.cell_id != cell_id:
            raise RecordDamage(f"{path}: it is the record of cell {record.cell_id}")
        return record

    def read_file(self, record: Record, name: str) -> bytes:
        """A file beside a record, checked against it. Raises RecordDamage where it is not what was written."""
        path = self.record_folder(record.cell_id) / name
        try:
            content = read_plain(path)
        except FileNotFoundError:
            raise RecordDamage(f"{path} is missing") from None
        except OSError as error:
            raise RecordDamage(f"{path}: {error}") from error
        if content_digest(content) != record.files[name]["digest"]:
            raise RecordDamage(f"{path} is not what was written (digest differs)")
        return content

    def samples(self, record: Record) -> bytes | None:
        """The Parquet file with the record's per-frame measurements, or None where it has none."""
        return self.read_file(record, SAMPLES_FILE) if SAMPLES_FILE in record.files else None

    def entries(self) -> dict[str, IndexEntry]:
        """All records as the index knows them, without opening any; records that it misses are read."""
        known = self._index.read()
        found: dict[str, IndexEntry] = {}
        for cell_id in self._present():
            entry = known.get(cell_id) or self._entry(cell_id)
            if entry is not None:
                found[cell_id] = entry
        return found

    def sound_entries(self, cell_ids: Iterable[str]) -> tuple[dict[str, IndexEntry], dict[str, str]]:
        """Those of these cells whose record is whole to the last byte, and why others with one are not."""
        known = self.entries()
        sound: dict[str, IndexEntry] = {}
        damaged: dict[str, str] = {}
        present = self._present()
        for cell_id in cell_ids:
            entry = known.get(cell_id)
            if entry is None:
                if cell_id in present:
                    damaged[cell_id] = "its record cannot be read"
                continue
            problem = self._problem(entry)
            if problem is not None and (fresh := self._entry(cell_id)) is not None:
                problem = self._problem(entry := fresh)  # the index may be older than the record
            if problem is None:
                sound[cell_id] = entry
            else:
                damaged[cell_id] = problem
        return sound, damaged

    def drop_record(self, cell_id: str) -> None:
        with self._writing():
            if self.record_folder(cell_id).exists():
                remove_folder(self.record_folder(cell_id))

    def rebuild_index(self) -> None:
        """Write the index again from what is there; the engine does so when a run ends."""
        with self._writing():
            self._index.rewrite(self.entries().values())

    def refusal(self, error: OSError) -> StoreError:
        """What ends a run where the system lets neither it nor a worker of it write to its folder."""
        message = f"cannot write to {self.folder}: {error}; all earlier records are kept: fix this and run again"
        return StoreError(message)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self.refusal(error) from error

    def _problem(self, entry: IndexEntry) -> str | None:
        folder = f"{self.records_folder}/{entry.cell_id[:2]}/{entry.cell_id}/"
        for name, expected in entry.digests.items():
            try:
                content = read_plain(folder + name)
            except FileNotFoundError:
                return f"{name} is missing"
            except OSError as error:
                return f"{name} cannot be read: {error.strerror}"
            if content_digest(content) != expected:
                return f"{name} is damaged (digest differs)"
        return None

    def _entry(self, cell_id: str) -> IndexEntry | None:
        path = self.record_folder(cell_id) / RECORD_FILE
        try:
            return entry_from_record(self.read_record(cell_id), read_plain(path))
        except (StoreError, OSError) as error:
            log.warning("%s", error)
            return None

    def _present(self) -> set[str]:
        """Ids of all cells that have a record folder."""
        found: set[str] = set()
        if self.records_folder.is_dir():
            for shard in os.scandir(self.records_folder):
                if len(shard.name) == 2:
                    found.update(name for name in os.listdir(shard.path) if not name.startswith("."))
        return found

    def _tidy(self) -> None:
        """Make the folders and delete what interrupted writers left."""
        for folder in (self.folder, self.records_folder, self.coded_folder, self.environments.folder):
            folder.mkdir(parents=True, exist_ok=True)
            sweep(folder)
        for shard in self.records_folder.glob("??"):
            sweep(shard)
