"""From a bundle to a run folder, which appears whole or not at all."""

from __future__ import annotations

import hashlib
import shutil
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.bundling.container import opened
from codecbench.core.engine.bundling.manifest import FileFacts, Manifest
from codecbench.core.engine.storage.atomic import make_folder, whole_folder
from codecbench.core.engine.storage.store import Store

_CHUNK: Final = 1 << 20


def folder_beside(path: Path) -> Path:
    """Where a bundle is unpacked if nothing else is said: its name without `.zip`."""
    return path.with_suffix("") if path.suffix == ".zip" else path.with_name(f"{path.name}.opened")


def unpack_bundle(path: Path, folder: Path) -> Manifest:
    """Put the files of a bundle into `folder`, which must not be there yet, each checked by its size and SHA-256.

    The plan in it carries no seal, so it counts as made elsewhere: nothing that it names is opened. Raises StoreError
    for a bundle that is refused, and for a folder that is there; OSError where it cannot be written. Then the folder,
    and those above it, are as they were.
    """
    if folder.exists() or folder.is_symlink():
        raise StoreError(f"{folder} is there already; name another folder with --out")
    missing = [parent for parent in folder.parents if not parent.exists()]
    try:
        return _unpacked(path, folder)
    except BaseException:
        for parent in missing:
            with suppress(OSError):  # not made, or in use by others
                parent.rmdir()
        raise


def _unpacked(path: Path, folder: Path) -> Manifest:
    with opened(path) as bundle:
        make_folder(folder.parent)
        total = sum(facts.size for facts in bundle.manifest.files.values())
        if total > (free := shutil.disk_usage(folder.parent).free):
            raise StoreError(f"{path} unpacks to {total:,} bytes; {folder.parent} has {free:,} left")
        with whole_folder(folder) as new:
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
    """Raise ValueError where nothing could be shown: a bundle may hold, under the right hashes, what cannot be read."""
    try:
        plan = store.read_plan()
    except StoreError as error:
        raise ValueError(f"its plan.json is damaged ({error.__cause__})") from error
    if not store.sound_entries(cell.id for cell in plan.cells)[0]:
        raise ValueError(f"none of its {len(plan.cells)} cells has a record that can be read")


def _copy(name: str, facts: FileFacts, source: IO[bytes], output: IO[bytes]) -> None:
    """Copy a file. Raises ValueError where it is not the one that the manifest names."""
    whole, size = hashlib.sha256(), 0
    while (chunk := source.read(_CHUNK)) and size <= facts.size:
        size += len(chunk)
        whole.update(chunk)
        output.write(chunk)
    if size != facts.size or whole.hexdigest() != facts.sha256:
        raise ValueError(f"{name!r} is not what was bundled (SHA-256 differs)")
