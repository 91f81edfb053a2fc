"""From a run folder to a bundle: the same run gives the same bytes."""

from __future__ import annotations

import hashlib
import zipfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.bundling.container import opened
from codecbench.core.engine.bundling.manifest import MANIFEST, FileFacts, Manifest
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.storage.atomic import open_whole
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.plain_file import open_plain
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.record_index import IndexEntry
from codecbench.core.engine.storage.store import Store

ENDING: Final = ".bundle.zip"

_CHUNK: Final = 1 << 20
_DATE: Final = (1980, 1, 1, 0, 0, 0)
"""The first that a zip file knows: when a file was written says nothing of the run."""
_PLAIN_FILE: Final = 0o100644 << 16


@dataclass(frozen=True)
class Bundle:
    """A bundle that was written. sha256: of the whole file."""

    path: Path
    size_bytes: int
    sha256: str
    manifest: Manifest


def write_bundle(folder: Path, path: Path | None = None, *, bitstreams: bool = False) -> Bundle:
    """Put a run folder into one file, by default `FOLDER.bundle.zip` beside it.

    It holds the plan, its matrix and the records of its cells, not what is made from them, and not who sealed the plan.
    Raises StoreError for a folder that is no run, has no results, is being written to or is damaged, and OSError.
    """
    store = Store(folder)
    plan = store.read_plan()
    entries = _sound_entries(store, plan)
    path = path or folder.absolute().with_name(folder.absolute().name + ENDING)
    counts = Counter(entry.status for entry in entries.values())
    with open_whole(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        files = {name: _added(archive, name, source) for name, source in _sources(store, plan, entries, bitstreams)}
        manifest = Manifest(
            codecbench=version("codecbench"),
            name=plan.name,
            cells=len(plan.cells),
            statuses=dict(sorted(counts.items())),
            bitstreams=bitstreams,
            files=files,
        )
        _added(archive, MANIFEST, BytesIO(manifest.model_dump_json(indent=1).encode() + b"\n"))
    _require_openable(path)
    with open(path, "rb") as whole:
        return Bundle(path, path.stat().st_size, hashlib.file_digest(whole, "sha256").hexdigest(), manifest)


def _require_openable(path: Path) -> None:
    """Remove a bundle that is larger than what anybody may open. Raises StoreError."""
    try:
        with opened(path):
            pass
    except StoreError:
        path.unlink()
        raise


def _sound_entries(store: Store, plan: Plan) -> dict[str, IndexEntry]:
    """What the index knows of the plan's cells that have a record."""
    if store.in_use():
        raise StoreError(f"{store.folder} is being written to; bundle it when its run has ended")
    sound, damaged = store.sound_entries(cell.id for cell in plan.cells)
    if damaged:
        cell_id, reason = next(iter(damaged.items()))
        message = f"{store.folder} has {len(damaged)} damaged records (of cell {cell_id}: {reason})"
        raise StoreError(f"{message}; run its matrix again, which computes them, then bundle it")
    if not sound:
        raise StoreError(f"{store.folder} has no results yet; `codecbench run` computes them")
    return sound


def _sources(
    store: Store, plan: Plan, entries: dict[str, IndexEntry], bitstreams: bool
) -> Iterator[tuple[str, BinaryIO]]:
    """Every file by its name in the bundle, sorted, open to be read."""
    matrix, portable = PlanFile(store.folder).portable()
    places = {
        f"environment/{name}.json": store.environments.folder / f"{name}.json" for name in store.environments.read()
    }
    for cell_id, entry in entries.items():
        folder = store.record_folder(cell_id)
        places |= {f"records/{cell_id[:2]}/{cell_id}/{name}": folder / name for name in entry.digests}
    for job in plan.jobs if bitstreams else ():
        path = store.coded_path(job.id)
        if path.exists():
            BitstreamFile(path, job.id)
            places |= {f"coded/{file.name}": file for file in (path, path.with_suffix(".code")) if file.exists()}
    yield "matrix.yaml", BytesIO(matrix)
    yield "plan.json", BytesIO(portable)
    for name in sorted(places):
        with open_plain(places[name]) as source:
            yield name, source


def _added(archive: zipfile.ZipFile, name: str, source: BinaryIO) -> FileFacts:
    info = zipfile.ZipInfo(name, _DATE)
    info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 3, _PLAIN_FILE
    info.file_size = source.seek(0, 2)
    source.seek(0)
    whole, size = hashlib.sha256(), 0
    with archive.open(info, "w") as target:
        while chunk := source.read(_CHUNK):
            target.write(chunk)
            whole.update(chunk)
            size += len(chunk)
    return FileFacts(size=size, sha256=whole.hexdigest())
