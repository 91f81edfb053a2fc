"""Pictures of the report: frames at matched rate."""

from __future__ import annotations

import logging
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.planning.model import PluginSetting, SequenceEntry
from codecbench.core.engine.planning.plan import coding_id
from codecbench.core.engine.registry import Registry, installed
from codecbench.core.engine.running.coding import CodedFrames, WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.report.frame_views import FrameView, frame_view
from codecbench.core.results.run_result import RunResult

log = logging.getLogger("codecbench.report")

_SETTINGS_A_SEQUENCE: Final = 36
"""Settings whose pictures the page shows of one sequence, spread over the rates."""


def frame_pictures(run: RunResult, budget_bytes: int) -> dict[str, Any]:
    """`frames` and `originals` as the page's script takes them, ordered by rate so that neighbours compare fairly.

    Each sequence has an equal share of the budget; where it does not do for all settings, they are thinned evenly.
    """
    originals: list[str] = []
    frames: list[dict[str, Any]] = []
    share = budget_bytes // max(1, len(run.plan.sequences))
    for entry in run.plan.sequences:
        views = [(setting, rate, view) for setting, rate in _chosen(run, entry) if (view := _view(run, entry, setting))]
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


def _view(run: RunResult, entry: SequenceEntry, setting: PluginSetting) -> FrameView | None:
    """The middle frame of a sequence under a setting; None, with a line in the log, where it cannot be made again."""
    path = Store(run.folder).coded_path(coding_id(entry, setting)).absolute()
    dataset = entry.dataset
    asked: list[tuple[Kind, str]] = [("dataset", dataset.name), ("codec", setting.name)]
    named = dataset.name, dataset.params, setting.name, setting.params
    try:
        return FrameView(**installed().ask(view_values, *named, str(path), entry.frames // 2, of=asked))
    except (CodecbenchError, OSError, ValueError) as error:
        log.warning("no picture of %s %s on %s: %s", setting.name, setting.label, entry.name, error)
        return None


def view_values(
    registry: Registry,
    dataset: str,
    dataset_params: dict[str, Any],
    codec: str,
    codec_params: dict[str, Any],
    path: str,
    frame: int,
) -> dict[str, Any]:
    """The fields of the view of one frame, whose bitstream is in the file `path`."""
    sequence = registry.create("dataset", dataset, dataset_params).open()
    instance = registry.create("codec", codec, codec_params)
    coded = CodedFrames(sequence, instance, BitstreamFile(Path(path)), WorkPosition())
    return asdict(frame_view(coded.frame(frame)))
