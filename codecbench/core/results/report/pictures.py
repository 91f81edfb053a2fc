"""Pictures of the report: frames at matched rate."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import CodecbenchError, DatasetError
from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import Frame, Sequence
from codecbench.core.engine.foreign_text import clean_line
from codecbench.core.engine.identity import canonical_json
from codecbench.core.engine.planning.model import PluginSetting, SequenceEntry
from codecbench.core.engine.planning.plan import coding_id
from codecbench.core.engine.registry import Registry, installed
from codecbench.core.engine.running.coding import checked_decoding
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.report.frame_views import FrameView, frame_view
from codecbench.core.results.run_result import RunResult

log = logging.getLogger("codecbench.report")

SAME_PLACE: Final = "same"
"""Says that sequences are opened where the plan names them."""

_SETTINGS_A_SEQUENCE: Final = 36
"""Settings whose pictures the page shows of one sequence, spread over the rates."""


def frame_pictures(run: RunResult, budget_bytes: int, sequences_from: str | None = None) -> dict[str, Any]:
    """`frames` and `originals` as the page's script takes them, ordered by rate so that neighbours compare fairly.

    sequences_from: a folder in which sequences are looked for, or `same` for where the plan says, even if the run was
    made elsewhere; None opens only what this user's own plan names.
    Each sequence has an equal share of the budget; where it does not do for all settings, they are thinned evenly.
    """
    originals: list[str] = []
    frames: list[dict[str, Any]] = []
    share = budget_bytes // max(1, len(run.plan.sequences))
    for entry in run.plan.sequences:
        params = _dataset_params(run, entry, sequences_from)
        if params is None:
            continue
        chosen = _chosen(run, entry)
        views = [(setting, rate, view) for setting, rate in chosen if (view := _view(run, entry, params, setting))]
        views = _thinned(views, share)
        for setting, rate, view in views:
            name = f"{setting.name} {setting.label}".strip()
            spent = _spent(run, rate)
            frames.append(
                {
                    "sequence": entry.name,
                    "original": len(originals),
                    "title": " · ".join(filter(None, (spent, name))),
                    "decoded": view.decoded,
                    "difference": view.difference,
                    "caption": ", ".join(filter(None, (name, spent, f"frame {entry.frames // 2}"))),
                    "lost": f"difference x4; {view.lost} of {view.features} features lost (red)",
                }
            )
        originals += [view.original for *_, view in views[:1]]
    return {"frames": frames, "originals": originals}


def _chosen(run: RunResult, entry: SequenceEntry) -> list[tuple[PluginSetting, float]]:
    """Codec settings but the baseline's by rising rate, those of unknown rate last, thinned evenly."""
    settings = {(r.cell.codec.name, r.cell.codec.label): r.cell.codec for r in run.results}
    known = [
        (rate, settings[codec, label])
        for (sequence, codec, label), rate in run.rates.items()
        if sequence == entry.name and codec not in run.meaning.baselines
    ]
    known.sort(key=lambda pair: (np.isnan(pair[0]), pair[0]))
    picks = np.unique(np.linspace(0, len(known) - 1, min(len(known), _SETTINGS_A_SEQUENCE)).round().astype(int))
    return [(known[pick][1], known[pick][0]) for pick in picks] if known else []


def _spent(run: RunResult, rate: float) -> str:
    """A rate for people; nothing where it is not known."""
    return "" if run.rate is None or np.isnan(rate) else f"{rate * run.rate.factor:.3g} {run.rate.unit}"


_View = tuple[PluginSetting, float, FrameView]


def _thinned(views: list[_View], budget_bytes: int) -> list[_View]:
    """As many views, spread evenly, as the budget allows."""
    count = len(views)
    while count:
        picks = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))
        chosen = [views[pick] for pick in picks]
        weight = len(chosen[0][2].original) + sum(len(view.decoded) + len(view.difference) for *_, view in chosen)
        if weight <= budget_bytes:
            return chosen
        count -= 1
    return []


def _dataset_params(run: RunResult, entry: SequenceEntry, sequences_from: str | None) -> dict[str, Any] | None:
    """The parameters to open a sequence with; None, with a line in the log, where it may not be opened."""
    try:
        if sequences_from not in (None, SAME_PLACE):
            return {name: _relocated(value, Path(sequences_from)) for name, value in entry.dataset.params.items()}
        elsewhere = PlanFile(run.folder).origin_elsewhere() if sequences_from is None else None
        if elsewhere is not None:
            message = f"the run was made in {elsewhere}, and what its plan names is not opened unasked"
            raise DatasetError(f"{message}; say --sequences-from FOLDER, or --sequences-from same")
    except (CodecbenchError, OSError) as error:
        log.warning("no pictures of %s: %s", entry.name, clean_line(str(error)))
        return None
    return entry.dataset.params


def _relocated(value: Any, folder: Path) -> Any:
    """A parameter that is a path, as it is called in `folder`; others as they are. Raises DatasetError."""
    if not isinstance(value, str) or "/" not in value:
        return value
    home, parts = folder.resolve(), [part for part in Path(value).parts if part not in ("/", "..")]
    for start in range(len(parts)):
        path = home.joinpath(*parts[start:])
        if path.exists() and path.resolve().is_relative_to(home):
            return str(path)
    raise DatasetError(f"{parts[-1] if parts else value} is not in {folder}")


def _view(run: RunResult, entry: SequenceEntry, params: dict[str, Any], setting: PluginSetting) -> FrameView | None:
    """The middle frame of a sequence under a setting; None, with a line in the log, where it cannot be made again."""
    job_id = coding_id(entry, setting)
    path = str(Store(run.folder).coded_path(job_id).absolute())
    asked: list[tuple[Kind, str]] = [("dataset", entry.dataset.name), ("codec", setting.name)]
    sequence = entry.dataset.name, params, entry.fingerprint, entry.frames
    try:
        values = installed().ask(view_values, *sequence, setting.name, setting.params, path, job_id, of=asked)
    except (CodecbenchError, IndexError, OSError, ValueError) as error:
        where = f"{setting.name} {setting.label} on {entry.name}"
        log.warning("no picture of %s: %s", where, clean_line(str(error)))
        return None
    return FrameView(**values)


def view_values(
    registry: Registry,
    dataset: str,
    dataset_params: dict[str, Any],
    fingerprint: str,
    frames: int,
    codec: str,
    codec_params: dict[str, Any],
    path: str,
    job_id: str,
) -> dict[str, Any]:
    """The fields of the view of a sequence's middle frame, whose bitstream is in the file `path` of the job.

    Raises DatasetError where the sequence is no longer the one of the fingerprint, and BitstreamDamage where the file
    is not the job's.
    """
    middle = _middle_frame(registry, dataset, canonical_json(dataset_params).decode(), fingerprint, frames)
    bitstream = BitstreamFile(Path(path), job_id).read(middle.index)
    decoded = registry.create("codec", codec, codec_params).decode(bitstream)
    return asdict(frame_view(CodedFrame(middle, bitstream, checked_decoding(decoded, middle.image))))


@lru_cache(maxsize=1)
def _middle_frame(registry: Registry, dataset: str, params: str, fingerprint: str, frames: int) -> Frame:
    """The middle frame of a sequence, read once for all settings. params: as JSON."""
    sequence: Sequence = registry.create("dataset", dataset, json.loads(params)).open()
    if sequence.fingerprint != fingerprint or len(sequence) != frames:
        raise DatasetError("its frames are no longer those of the run")
    return sequence.read(frames // 2)
