"""Bundles from Python: a run to one file, and back to its results."""

from __future__ import annotations

from pathlib import Path

from codecbench.core.contracts.errors import PluginError
from codecbench.core.engine.bundling.packing import write_bundle
from codecbench.core.engine.bundling.unpacking import folder_beside, unpack_bundle
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.registry import Registry
from codecbench.core.results.collect import open_run
from codecbench.core.results.run_result import RunResult


def bundle(run: RunResult | str | Path, path: str | Path | None = None, *, bitstreams: bool = False) -> Path:
    """Put a run, or the run in a folder, into one file and return its path, by default `FOLDER.bundle.zip`.

    bitstreams: with what the codecs wrote. Raises StoreError for a folder that is no run, has no results, is being
    written to or is damaged.
    """
    folder = run.folder if isinstance(run, RunResult) else Path(run)
    return write_bundle(folder, None if path is None else Path(path), bitstreams=bitstreams).path


def open_bundle(path: str | Path, out: str | Path | None = None) -> RunResult:
    """Unpack a bundle into the folder `out`, by default beside it, and return its results.

    No code of the bundle's is run. Raises StoreError for a bundle that is refused, and where the folder is there.
    """
    folder = folder_beside(Path(path)) if out is None else Path(out)
    unpack_bundle(Path(path), folder)
    return open_run(folder)


def absent_plugins(plan: Plan, registry: Registry) -> list[str]:
    """The plugins of a plan that are not installed, each with the distribution that it was of."""
    used = {(setting.kind, setting.name): setting for cell in plan.cells for setting in cell.plugins}
    found = []
    for (kind, name), setting in used.items():
        try:
            registry.find(kind, name)
        except PluginError:
            found.append(setting.full_name)
    return found
