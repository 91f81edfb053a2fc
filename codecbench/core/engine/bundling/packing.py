"""Pack a run folder into a bundle, reproducibly, and unpack a bundle into a run folder, completely or not at all."""

from __future__ import annotations

import hashlib
import shutil
import zipfile
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import IO, BinaryIO, Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.bundling.container import MANIFEST, FileFacts, Manifest, open_bundle
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.storage.atomic import make_folder, open_whole, open_whole_folder
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.plain_file import open_plain
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.record_index import IndexEntry
from codecbench.core.engine.storage.store import Store

ENDING: Final = ".bundle.zip"

_CHUNK: Final = 1 << 20
_DATE: Final = (1980, 1, 1, 0, 0, 0)
"""The first date that a zip file can store: when a file was written is irrelevant to the run."""
_PLAIN_FILE: Final = 0o100644 << 16


@dataclass(frozen=True)
class Bundle:
    """A bundle that was written."""

    path: Path
    size_bytes: int
    sha256: str
    """Of the whole file."""
    manifest: Manifest


def write_bundle(folder: Path, path: Path | None = None, *, bitstreams: bool = False) -> Bundle:
    """Pack a run folder into one file, by default `FOLDER.bundle.zip` beside it.

    It contains the plan without its seal, its matrix and the records of its cells, but nothing made from them. Raises
    OSError, and StoreError if the folder is no run, has no results, is being written to or is damaged.
    """
    store = Store(folder)
    plan = store.read_plan()
    entries = _sound_entries(store, plan)
    path = path or folder.absolute().with_name(folder.absolute().name + ENDING)
    counts = Counter(entry.status for entry in entries.values())
    with open_whole(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        files = {name: _add_file(archive, name, source) for name, source in _sources(store, plan, entries, bitstreams)}
        manifest = Manifest(
            codecbench=version("codecbench"),
            name=plan.name,
            cells=len(plan.cells),
            statuses=dict(sorted(counts.items())),
            bitstreams=bitstreams,
            files=files,
        )
        _add_file(archive, MANIFEST, BytesIO(manifest.model_dump_json(indent=1).encode() + b"\n"))
    _require_openable(path)
    with open(path, "rb") as stream:
        return Bundle(path, path.stat().st_size, hashlib.file_digest(stream, "sha256").hexdigest(), manifest)


def _require_openable(path: Path) -> None:
    """Remove a bundle that exceeds the limits for opening. Raises StoreError."""
    try:
        with open_bundle(path):
            pass
    except StoreError:
        path.unlink()
        raise


def _sound_entries(store: Store, plan: Plan) -> dict[str, IndexEntry]:
    """Return the index entries of the plan's cells that have a record."""
    if store.in_use():
        raise StoreError(f"a run is writing to {store.folder}; bundle it when the run has ended")
    sound, damaged = store.sound_entries(cell.id for cell in plan.cells)
    if damaged:
        cell_id, reason = next(iter(damaged.items()))
        message = f"{store.folder} has {len(damaged)} damaged records (of cell {cell_id}: {reason})"
        raise StoreError(f"{message}; run its matrix again to compute them, then bundle it")
    if not sound:
        raise StoreError(f"{store.folder} has no results yet; `codecbench run` computes them")
    return sound


def _sources(
    store: Store, plan: Plan, entries: dict[str, IndexEntry], bitstreams: bool
) -> Iterator[tuple[str, BinaryIO]]:
    """Yield every file with its name in the bundle, sorted and opened for reading."""
    matrix, portable = PlanFile(store.folder).portable()
    paths = {
        f"environment/{name}.json": store.environments.folder / f"{name}.json" for name in store.environments.read()
    }
    for cell_id, entry in entries.items():
        folder = store.record_folder(cell_id)
        paths |= {f"records/{cell_id[:2]}/{cell_id}/{name}": folder / name for name in entry.digests}
    for job in plan.jobs if bitstreams else ():
        path = store.coded_path(job.id)
        if path.exists():
            BitstreamFile(path, job.id)
            paths |= {f"coded/{file.name}": file for file in (path, path.with_suffix(".code")) if file.exists()}
    yield "matrix.yaml", BytesIO(matrix)
    yield "plan.json", BytesIO(portable)
    for name in sorted(paths):
        with open_plain(paths[name]) as source:
            yield name, source


def _add_file(archive: zipfile.ZipFile, name: str, source: BinaryIO) -> FileFacts:
    info = zipfile.ZipInfo(name, _DATE)
    info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 3, _PLAIN_FILE
    info.file_size = source.seek(0, 2)
    source.seek(0)
    digest, size = hashlib.sha256(), 0
    with archive.open(info, "w") as target:
        while chunk := source.read(_CHUNK):
            target.write(chunk)
            digest.update(chunk)
            size += len(chunk)
    return FileFacts(size=size, sha256=digest.hexdigest())


def folder_beside(path: Path) -> Path:
    """Return the default folder for unpacking a bundle: its name without `.zip`."""
    return path.with_suffix("") if path.suffix == ".zip" else path.with_name(f"{path.name}.opened")


def unpack_bundle(path: Path, folder: Path) -> Manifest:
    """Unpack a bundle into `folder`, which must not exist, and check each file's size and SHA-256.

    The plan in it carries no seal, so it counts as made elsewhere: nothing that it names is opened. Raises StoreError
    if the bundle is refused or the folder exists, and OSError if it cannot be written. The folder and its parents are
    then as before.
    """
    if folder.exists() or folder.is_symlink():
        raise StoreError(f"{folder} already exists; choose another folder with --out")
    missing = [parent for parent in folder.parents if not parent.exists()]
    try:
        return _unpack(path, folder)
    except BaseException:
        for parent in missing:
            with suppress(OSError):  # it was not made, or others use it
                parent.rmdir()
        raise


def _unpack(path: Path, folder: Path) -> Manifest:
    with open_bundle(path) as bundle:
        make_folder(folder.parent)
        total = sum(facts.size for facts in bundle.manifest.files.values())
        if total > (free := shutil.disk_usage(folder.parent).free):
            raise StoreError(f"{path} unpacks to {total:,} bytes; {folder.parent} has {free:,} free")
        with open_whole_folder(folder) as new:
            for name, facts in bundle.manifest.files.items():
                target = new / name
                target.parent.mkdir(parents=True, exist_ok=True)
                with bundle.archive.open(name) as source, open(target, "xb") as output:
                    _copy(name, facts, source, output)
            (new / "records").mkdir(exist_ok=True)
            Store(new).rebuild_index()
            _require_results(Store(new))
    return bundle.manifest


def _require_results(store: Store) -> None:
    """Raise ValueError if no record can be read, which the right hashes do not rule out."""
    try:
        plan = store.read_plan()
    except StoreError as error:
        raise ValueError(f"its plan.json is damaged ({error.__cause__})") from error
    if not store.sound_entries(cell.id for cell in plan.cells)[0]:
        raise ValueError(f"none of its {len(plan.cells)} cells has a record that can be read")


def _copy(name: str, facts: FileFacts, source: IO[bytes], output: IO[bytes]) -> None:
    """Copy a file. Raises ValueError if it is not the one that the manifest lists."""
    digest, size = hashlib.sha256(), 0
    while (chunk := source.read(_CHUNK)) and size <= facts.size:
        size += len(chunk)
        digest.update(chunk)
        output.write(chunk)
    if size != facts.size or digest.hexdigest() != facts.sha256:
        raise ValueError(f"{name!r} is not what was bundled (SHA-256 differs)")
