"""Where a run starts: which cells of a plan an earlier run in the same folder has computed, and why others not.

A record with status `ok` is kept for ever: as long as it is whole, as long as its plugins' parameters would be the
same today, and until it is asked for again by name. Where its plugins' code has changed it is kept and the run says so.
Cells that failed, crashed, timed out or were unsupported are tried again, because a run is repeated after mending what
was wrong.
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
    """What an earlier run left of a plan, by cell id.

    kept: the status of cells that are not computed again. damaged: why records that are not whole are. outdated: why
    whole ones are, though they once were `ok`. retried: how many that never were `ok` are. notices: what to say of
    cells that are kept though code has changed.
    """

    kept: dict[str, Status]
    damaged: dict[str, str]
    outdated: dict[str, str]
    retried: int
    notices: tuple[str, ...] = ()


def resume(plan: Plan, store: Store, registry: Registry, recompute: Iterable[str] = ()) -> Resumption:
    """Look at what is in the run folder, and remove from it what is to be computed again.

    recompute: names of codecs, evaluators and sequences whose cells are not kept; of codecs and sequences the
    bitstreams are not either. Raises ParamsError for a name that the plan does not have.
    """
    asked = _requested_by_name(plan, recompute)
    sound, damaged = store.sound_entries(cell.id for cell in plan.cells)
    outdated = outdated_cells(plan, sound, store) | {id_: why for id_, why in asked.items() if id_ in sound}
    for cell_id, reason in damaged.items():
        log.warning("record %s will be computed again: %s", cell_id, reason)
    for reason, count in Counter(outdated.values()).items():
        log.warning("%d record(s) will be computed again: %s", count, reason)
    for cell_id in (*damaged, *outdated):
        store.drop_record(cell_id)
    for job in plan.jobs:
        if job.id in asked and store.coded_path(job.id).exists():
            store.drop_coded(job.id, asked[job.id])
    kept = kept_cells(plan, {id_: entry for id_, entry in sound.items() if id_ not in outdated})
    with_result = {id_: sound[id_] for id_, status in kept.items() if status == "ok"}
    notices = code_notices(plan, with_result, store, registry)
    return Resumption(kept, damaged, outdated, len(sound) - len(outdated) - len(kept), tuple(notices))


def kept_cells(plan: Plan, entries: Mapping[str, IndexEntry]) -> dict[str, Status]:
    """The cells whose record says all that there is to say, with their status."""
    kept: dict[str, Status] = {}
    for cell in plan.cells:
        entry = entries.get(cell.id)
        if entry is not None and entry.status == "ok":
            kept[cell.id] = "ok"
        elif entry is not None and entry.status == "unsupported" and entry.reason == cell.unsupported:
            kept[cell.id] = "unsupported"
    return kept


def outdated_cells(plan: Plan, entries: Mapping[str, IndexEntry], store: Store) -> dict[str, str]:
    """The cells whose record was made with other values of parameters at their default, and which those are.

    A parameter at its default is in no identity, so that plugins can gain parameters; the price is this comparison.
    It opens one record for each pair of settings that differ from those of the plan in any parameter.
    """
    digests: dict[tuple[PluginSetting, PluginSetting], str] = {}
    reasons: dict[tuple[str, str], str | None] = {}
    found = {}
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
            found[cell.id] = reason
    return found


def _changed_default(cell: Cell, store: Store) -> str | None:
    """Which parameter of a cell's plugins had another value when its record was made, or None."""
    try:
        then = store.read_record(cell.id).cell
    except StoreError:
        return None  # damaged or gone, which is another reason
    stored = [then.get("codec"), then.get("evaluator"), *then.get("uses", ())]
    for before, setting in zip(stored, (cell.codec, cell.evaluator, *cell.evaluator.uses), strict=False):
        reason = _changed_parameter(before["params"], setting) if before else "its record does not say which"
        if reason is not None:
            return f"{setting.kind} {setting.name}: {reason}"
    return None


def _changed_parameter(before: dict[str, Any], setting: PluginSetting) -> str | None:
    """Which effective parameter had another value before, or None. Of one that there was not, the default changed
    nothing."""
    for parameter, value in setting.effective_params().items():
        if (then := before.get(parameter, value)) != value:
            return f"the default of {parameter} was {then!r} and is {value!r}"
    return None


def _requested_by_name(plan: Plan, recompute: Iterable[str]) -> dict[str, str]:
    """Why cells and jobs are computed again that were asked for by name, by their ids."""
    asked = {}
    names = set(recompute)
    found: set[str] = set()
    for job in plan.jobs:
        if hit := names & {job.sequence.name, job.codec.name}:
            asked[job.id] = f"{', '.join(sorted(hit))} was asked for"
    for cell in plan.cells:
        if hit := names & {cell.sequence.name, cell.codec.name, cell.evaluator.name}:
            asked[cell.id] = f"{', '.join(sorted(hit))} was asked for"
            found |= hit
    known = {name for cell in plan.cells for name in (cell.sequence.name, cell.codec.name, cell.evaluator.name)}
    for name in sorted(names - found):
        near = difflib.get_close_matches(name, known, n=1)
        meant = f"did you mean {near[0]!r}? " if near else ""
        message = f"nothing to recompute is called {name!r}; {meant}this matrix has"
        raise ParamsError(f"{message} {', '.join(sorted(known))}")
    return asked
