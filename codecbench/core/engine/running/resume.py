"""Determine where a run starts: which cells an earlier run computed, and why others must be computed.

A record with status `ok` is kept as long as it is intact, its plugins' parameters would be the same today, and nobody
asks by name to recompute it. If its plugins' code has changed, it is kept and the run says so. Cells that failed,
crashed, timed out or were unsupported are retried, because runs are repeated after fixing the cause.
"""

from __future__ import annotations

import difflib
import logging
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from codecbench.core.contracts.errors import ParamsError, StoreError
from codecbench.core.contracts.executor import Status
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.running.code_changes import code_notices
from codecbench.core.engine.storage.record import cell_description, settings_digest
from codecbench.core.engine.storage.record_index import IndexEntry
from codecbench.core.engine.storage.store import Store

log = logging.getLogger("codecbench.run")


@dataclass(frozen=True)
class Resumption:
    """What an earlier run left of a plan, by cell id."""

    kept: dict[str, Status]
    """Status of cells that are not computed again."""
    damaged: dict[str, str]
    """Why records are damaged."""
    outdated: dict[str, str]
    """Why intact records with status `ok` are computed again."""
    retried: int
    """Number of cells computed again whose status was not `ok`."""
    notices: tuple[str, ...] = ()
    """Messages about kept cells whose code has changed."""


def resume(plan: Plan, store: Store, registry: Registry, recompute: Iterable[str] = ()) -> Resumption:
    """Inspect the run folder, and remove from it what is to be computed again.

    recompute: names of codecs, evaluators and sequences whose cells are not kept; of codecs and sequences the
    bitstreams are not kept either. Raises ParamsError for a name that the plan does not have.
    """
    requested = _requested_by_name(plan, recompute)
    sound, damaged = store.sound_entries(cell.id for cell in plan.cells)
    outdated = outdated_cells(plan, sound, store) | {id_: why for id_, why in requested.items() if id_ in sound}
    for cell_id, reason in damaged.items():
        log.warning("record %s will be computed again: %s", cell_id, reason)
    for reason, count in Counter(outdated.values()).items():
        log.warning("%d record(s) will be computed again: %s", count, reason)
    for cell_id in (*damaged, *outdated):
        store.drop_record(cell_id)
    for job in plan.jobs:
        if job.id in requested and store.coded_path(job.id).exists():
            store.drop_coded(job.id, requested[job.id])
    kept = kept_cells(plan, {id_: entry for id_, entry in sound.items() if id_ not in outdated})
    with_result = {id_: sound[id_] for id_, status in kept.items() if status == "ok"}
    notices = code_notices(plan, with_result, store, registry)
    return Resumption(kept, damaged, outdated, len(sound) - len(outdated) - len(kept), tuple(notices))


def kept_cells(plan: Plan, entries: Mapping[str, IndexEntry]) -> dict[str, Status]:
    """Return the cells whose record is final, with their status."""
    kept: dict[str, Status] = {}
    for cell in plan.cells:
        entry = entries.get(cell.id)
        if entry is not None and entry.status == "ok":
            kept[cell.id] = "ok"
        elif entry is not None and entry.status == "unsupported" and entry.reason == cell.unsupported:
            kept[cell.id] = "unsupported"
    return kept


def outdated_cells(plan: Plan, entries: Mapping[str, IndexEntry], store: Store) -> dict[str, str]:
    """Return the cells whose record was made with other default values, with the parameter that differs.

    A parameter at its default is in no identity, so that plugins can gain parameters; this comparison makes up for it.
    It opens one record for each pair of settings that differ from those of the plan in any parameter.
    """
    digests: dict[tuple[PluginSetting, PluginSetting], str] = {}
    reasons: dict[tuple[str, str], str | None] = {}
    outdated = {}
    for cell in plan.cells:
        entry = entries.get(cell.id)
        if entry is None or entry.status != "ok":
            continue
        settings = (cell.codec, cell.evaluator)
        if settings not in digests:
            digests[settings] = settings_digest(cell_description(cell))
        pair = (entry.settings, digests[settings])
        if pair[0] != pair[1] and pair not in reasons:
            reasons[pair] = _changed_default(cell, store)
        if (reason := reasons.get(pair)) is not None:
            outdated[cell.id] = reason
    return outdated


def _changed_default(cell: Cell, store: Store) -> str | None:
    """Return which parameter of a cell's plugins had another value when its record was made, or None."""
    try:
        described = store.read_record(cell.id).cell
    except StoreError:
        return None  # damaged or gone: reported elsewhere
    stored = [described.get("codec"), described.get("evaluator"), *described.get("uses", ())]
    for before, setting in zip(stored, (cell.codec, cell.evaluator, *cell.evaluator.uses), strict=False):
        reason = _changed_parameter(before["params"], setting) if before else "its record does not have the parameters"
        if reason is not None:
            return f"{setting.kind} {setting.name}: {reason}"
    return None


def _changed_parameter(before: dict[str, Any], setting: PluginSetting) -> str | None:
    """Return which effective parameter had another value, or None. A parameter that did not exist is no change."""
    for parameter, value in setting.effective_params().items():
        if (old_value := before.get(parameter, value)) != value:
            return f"the default of {parameter} was {old_value!r} and is {value!r}"
    return None


def _requested_by_name(plan: Plan, recompute: Iterable[str]) -> dict[str, str]:
    """Return why cells and jobs are recomputed that were asked for by name, by their ids."""
    reasons = {}
    names = set(recompute)
    matched: set[str] = set()
    for job in plan.jobs:
        if hit := names & {job.sequence.name, job.codec.name}:
            reasons[job.id] = f"{', '.join(sorted(hit))} was requested"
    for cell in plan.cells:
        if hit := names & {cell.sequence.name, cell.codec.name, cell.evaluator.name}:
            reasons[cell.id] = f"{', '.join(sorted(hit))} was requested"
            matched |= hit
    known = {name for cell in plan.cells for name in (cell.sequence.name, cell.codec.name, cell.evaluator.name)}
    for name in sorted(names - matched):
        nearest = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {nearest[0]!r}? " if nearest else ""
        message = f"no codec, evaluator or sequence is called {name!r}; {hint}this matrix has"
        raise ParamsError(f"{message} {', '.join(sorted(known))}")
    return reasons
