"""Pictures of the report: frames at matched rate, and trajectories over ground truth."""

from __future__ import annotations

import logging
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.engine.planning.model import PluginSetting, SequenceEntry
from codecbench.core.engine.planning.plan import coding_id
from codecbench.core.engine.registry import installed
from codecbench.core.engine.running.coding import CodedFrames, WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.report.frame_views import FrameView, frame_view
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.trajectories import saved_trajectories

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
        views = [(one, rate, view) for one, rate in _chosen(run, entry) if (view := _view(run, entry, one))]
        views = _thinned(views, share)
        for setting, rate, view in views:
            name = f"{setting.name} {setting.label}".strip()
            frames.append(
                {
                    "sequence": entry.name,
                    "original": len(originals),
                    "title": f"{rate:.3g} bpp · {name}",
                    "decoded": view.decoded,
                    "difference": view.difference,
                    "caption": f"{name}, {rate:.3g} bpp, frame {entry.frames // 2}",
                    "lost": f"difference x4; {view.lost} of {view.features} features lost (red)",
                }
            )
        originals += [view.original for *_, view in views[:1]]
    return {"frames": frames, "originals": originals}


def _chosen(run: RunResult, entry: SequenceEntry) -> list[tuple[PluginSetting, float]]:
    """Codec settings by rising rate, thinned evenly."""
    rates: dict[tuple[str, str], float] = {}
    for row in run.wide[run.wide["sequence"] == entry.name].to_dict("records"):
        rates[row["codec"], row["setting"]] = float(row.get("quality.rate_bpp.mean", np.nan))
    settings = {(r.cell.codec.name, r.cell.codec.label): r.cell.codec for r in run.results}
    known = sorted((rate, key) for key, rate in rates.items() if not np.isnan(rate) and key[0] != "raw")
    picks = np.unique(np.linspace(0, len(known) - 1, min(len(known), _SETTINGS_A_SEQUENCE)).round().astype(int))
    return [(settings[known[pick][1]], known[pick][0]) for pick in picks] if known else []


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
    path = Store(run.folder).coded_path(coding_id(entry, setting))
    try:
        sequence = installed().create("dataset", entry.dataset.name, entry.dataset.params).open()
        codec = installed().create("codec", setting.name, setting.params)
        coded = CodedFrames(sequence, codec, BitstreamFile(path), WorkPosition())
        return frame_view(coded.frame(entry.frames // 2))
    except (CodecbenchError, OSError, ValueError) as error:
        log.warning("no picture of %s %s on %s: %s", setting.name, setting.label, entry.name, error)
        return None


def trajectory_pictures(run: RunResult) -> list[dict[str, Any]]:
    """One entry a trajectory of the first repeat of each setting, drawn over ground truth where there is some."""
    return [
        {
            "sequence": one.sequence,
            "codec": one.codec,
            "setting": " ".join(filter(None, (one.setting, one.evaluator_label))),
            "caption": one.caption,
            "truth": _line(one.truth),
            "estimate": _line(one.estimated),
            "optimised": _line(one.optimised),
        }
        for one in saved_trajectories(run)
        if one.repeat == 0
    ]


def _line(points: np.ndarray | None, most: int = 400) -> list[list[float]] | None:
    """At most `most` points of a (N, 2) path as rounded x and y lists."""
    if points is None or not len(points):
        return None
    picks = np.unique(np.linspace(0, len(points) - 1, min(len(points), most)).round().astype(int))
    return [[round(float(value), 4) for value in points[picks, axis]] for axis in (0, 1)]
