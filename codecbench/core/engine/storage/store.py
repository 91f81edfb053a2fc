"""A run folder: its layout, who may write to it, and which of its files are sound.

    matrix.yaml  plan.json  environment/<id>.json  coded/<job>  records/<xx>/<cell>/record.json
    records/index.jsonl  tables/  report/  run.log  lock

Every file is written whole and then renamed. A record is one folder (record.json, frames.parquet, artifacts) that is
renamed into place, so it is complete or absent. Every file identifies what it belongs to and carries a checksum: damage
is detected, reported, and repaired by the next run. Links that lead out of the folder are refused.
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
"""Depth down to which a run folder has files and folders of its own: `records/ab/<cell>`."""

_DURABLE_FROM_S: Final = 1.0
"""Write records of cells that took at least this many seconds durably.

Quicker ones, which are cheaper to compute again, reach the disk when the run ends.
"""


class Store:
    """The files of one run. Writing needs `locked`, which only one process can hold; reading needs nothing."""

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
        """Lock the folder for writing. Raises StoreError if another process holds it, or a link leads out of it.

        When the lock is released, everything written is on disk.
        """
        with ExitStack() as stack:
            with self._writing():
                make_folder(self.folder, durable=True)
                self.refuse_links()
                stack.enter_context(folder_lock.hold_lock(self.folder / "lock"))
                self._prepare_folders()
            yield
            with self._writing():
                sync_file_system(self.folder)

    def refuse_links(self) -> None:
        """Raise StoreError if a file or folder of the run is a link that leads out of its folder."""
        refuse_links(self.folder, _DEPTH)

    def in_use(self) -> bool:
        """Whether a process is writing to this folder now."""
        return folder_lock.is_locked(self.folder / "lock")

    def write_plan(self, plan: Plan) -> None:
        """Write the plan and the matrix that it was made from. Raises StoreError if that fails."""
        with self._writing():
            PlanFile(self.folder).write(plan)

    def read_plan(self) -> Plan:
        """Return the plan of the last run in this folder.

        Raises StoreError if it is missing or damaged, or if the folder has links that lead out of it.
        """
        self.refuse_links()
        return PlanFile(self.folder).read()

    def coded_path(self, job_id: str) -> Path:
        return self.coded_folder / f"{job_id}.bits"

    def has_coded(self, job_id: str, frames: int) -> bool:
        """Whether a sound file of this job's bitstreams exists; a damaged one is reported and removed."""
        path = self.coded_path(job_id)
        if not path.exists():
            return False
        try:
            is_complete = len(BitstreamFile(path, job_id)) == frames
            if is_complete and not self.encoders.damaged(job_id):
                return True
            reason = "the note of its encoder is damaged" if is_complete else "it has another number of frames"
        except BitstreamDamage as error:
            reason = str(error)
        self.drop_coded(job_id, reason)
        return False

    def write_coded(self, job_id: str, content: bytes) -> None:
        """Write a bitstream file that came from a worker which does not see this folder."""
        with self._writing():
            write_file(self.coded_path(job_id), content)

    def note_encoder(self, job_id: str, code: str) -> None:
        """Note which code of its codec encoded a job's bitstreams."""
        with self._writing():
            self.encoders.write(job_id, code)

    def drop_coded(self, job_id: str, reason: str) -> None:
        """Remove a bitstream file, so that the sequence is encoded again when needed."""
        log.warning("coded/%s.bits will be encoded again: %s", job_id, reason)
        with self._writing():
            self.coded_path(job_id).unlink(missing_ok=True)

    def record_folder(self, cell_id: str) -> Path:
        return Path(f"{self.records_folder}/{cell_id[:2]}/{cell_id}")

    def write_record(self, record: Record) -> Record:
        """Write a record with its contents, replacing an earlier one, and return it without them.

        Raises StoreError if that fails (disk full), and then changes nothing.
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
        """Return the checked record of a cell. Raises RecordDamage, or StoreError if there is none.

        entry: its index entry; a record with the digest in it is not checked a second time.
        """
        path = f"{self.records_folder}/{cell_id[:2]}/{cell_id}/{RECORD_FILE}"
        try:
            content = read_plain(path)
            known_good = entry is not None and content_digest(content) == entry.digests[RECORD_FILE]
            record = record_from_bytes(content, known_good=known_good)
        except FileNotFoundError:
            raise StoreError(f"{self.folder} has no record of cell {cell_id}") from None
        except (RecordDamage, OSError) as error:
            raise RecordDamage(f"{path}: {error}") from error
        if record.cell_id != cell_id:
            raise RecordDamage(f"{path}: it is the record of cell {record.cell_id}")
        return record

    def read_file(self, record: Record, name: str) -> bytes:
        """Return a file beside a record. Raises RecordDamage if it is not what was written."""
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
        """Return the Parquet file with the record's per-frame measurements, or None if it has none."""
        return self.read_file(record, SAMPLES_FILE) if SAMPLES_FILE in record.files else None

    def entries(self) -> dict[str, IndexEntry]:
        """Return the index entries of all records; only records that the index lacks are opened."""
        indexed = self._index.read()
        entries: dict[str, IndexEntry] = {}
        for cell_id in self._recorded_ids():
            entry = indexed.get(cell_id) or self._entry(cell_id)
            if entry is not None:
                entries[cell_id] = entry
        return entries

    def sound_entries(self, cell_ids: Iterable[str]) -> tuple[dict[str, IndexEntry], dict[str, str]]:
        """Return the entries of those cells whose record is intact to the last byte, and why others are damaged."""
        entries = self.entries()
        sound: dict[str, IndexEntry] = {}
        damaged: dict[str, str] = {}
        present = self._recorded_ids()
        for cell_id in cell_ids:
            entry = entries.get(cell_id)
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
        """Write the index again from the records; the engine does so when a run ends."""
        with self._writing():
            self._index.rewrite(self.entries().values())

    def refusal(self, error: OSError) -> StoreError:
        """Return the error that ends a run if this process or a worker cannot write to the folder."""
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

    def _recorded_ids(self) -> set[str]:
        """Return the ids of all cells that have a record folder."""
        ids: set[str] = set()
        if self.records_folder.is_dir():
            for shard in os.scandir(self.records_folder):
                if len(shard.name) == 2:
                    ids.update(name for name in os.listdir(shard.path) if not name.startswith("."))
        return ids

    def _prepare_folders(self) -> None:
        """Make the folders and delete what interrupted writers left."""
        for folder in (self.folder, self.records_folder, self.coded_folder, self.environments.folder):
            folder.mkdir(parents=True, exist_ok=True)
            sweep(folder)
        for shard in self.records_folder.glob("??"):
            sweep(shard)
