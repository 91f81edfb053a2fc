"""The frames that the report shows, by setting in order of rate."""

from __future__ import annotations

import base64
import logging
import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from codecbench.core.analysis.replanning import openable_params
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.view import KeypointOverlay
from codecbench.core.engine.hosting.host import limit_s
from codecbench.core.engine.planning.declared import offers_of
from codecbench.core.engine.planning.model import PluginSetting, SequenceEntry
from codecbench.core.engine.planning.plan import coding_id
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.running.frame_cache import MOST_BYTES
from codecbench.core.engine.running.workbench import Workbench
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.engine.text import clean_line
from codecbench.core.report.tables import three_digits
from codecbench.core.report.views import answer_picks

log = logging.getLogger("codecbench.report")

_SETTINGS_A_SEQUENCE: Final = 64
"""Settings of a sequence whose frames the page shows, spread over the rates."""
_MOST_FRAMES: Final = 5
"""Frames of one setting."""
_VIEWS: Final = 72
"""Frames of all settings together, above which settings have fewer than _MOST_FRAMES."""
_BYTES_A_PIXEL: Final = 0.9
"""Approximate bytes on the page of a pixel of a view."""
_LEAST_SIZE: Final = (360, 270)
_MOST_SIZE: Final = (640, 480)


@dataclass(frozen=True)
class FrameView:
    """The images of a frame as data URIs, with keypoints."""

    index: int
    original: str
    decoded: str
    difference: str
    width: int
    """Of the images in pixels, as the height."""
    height: int
    kept: list[int]
    """x and y in turn of the keypoints that are kept."""
    lost: list[int]
    """x and y in turn of the keypoints that are lost."""
    note: str
    """The overlay's note on the whole frame; empty if there is none."""

    @property
    def weight_bytes(self) -> int:
        return len(self.decoded) + len(self.difference) + 5 * (len(self.kept) + len(self.lost))


_Views = tuple[PluginSetting, float, list[FrameView]]
"""A codec setting, its rate, and its frames."""


def frame_pictures(
    run: RunResult, budget_bytes: int, sequences_from: str | None = None, wanted: Collection[int] = ()
) -> dict[str, Any]:
    """`frames` and `originals` for the page's script, ordered by rate so that neighbors compare fairly.

    sequences_from: a folder to search for sequences, or `same` for the plan's paths, even if the run was made
    elsewhere; None opens only what this user's own plan names. wanted: numbers of the frames to show of the sequences
    that have them; by default a few spread evenly. Each sequence has an equal share of the budget. If it does not
    suffice for all settings, those of the answer stay, see `answer_picks`, and the others are thinned evenly.
    """
    originals: list[dict[str, Any]] = []
    frames: list[dict[str, Any]] = []
    share = budget_bytes // max(1, len(run.plan.sequences))
    marker, plugins = _marker(run), Workbench(limit_s)
    first = [(pick.codec, pick.setting) for pick in answer_picks(run)]
    for entry in run.plan.sequences:
        settings = _settings_by_rate(run, entry, first)
        if settings and not _has_bitstreams(run, entry, settings):
            log.warning(
                "no images of %s: the run folder has no bitstreams, like one from a bundle without them", entry.name
            )
            continue
        params = _dataset_params(run, entry, sequences_from)
        if params is None:
            continue
        shape = _shape(entry.frames, len(settings), len(run.plan.sequences), share, wanted)
        views = [
            (setting, rate, views_of_setting)
            for setting, rate in settings
            if (views_of_setting := _views(run, entry, params, setting, shape, marker, plugins))
        ]
        places: dict[int, int] = {}
        fitting = _fit(views, share, first)
        if len(fitting) < len(views):
            log.warning("images of %d of %d settings on %s fit on the page", len(fitting), len(views), entry.name)
        for setting, rate, views_of_setting in fitting:
            title = " · ".join(filter(None, (_rate_words(run, rate), f"{setting.name} {setting.label}".strip())))
            for view in views_of_setting:
                if view.index not in places:
                    places[view.index] = len(originals)
                    originals.append({"picture": view.original, "width": view.width, "height": view.height})
                frames.append(
                    {
                        "sequence": entry.name,
                        "codec": setting.name,
                        "setting": setting.label,
                        "title": title,
                        "frame": view.index,
                        "original": places[view.index],
                        "decoded": view.decoded,
                        "difference": view.difference,
                        "kept": view.kept,
                        "lost": view.lost,
                        "note": view.note,
                    }
                )
    plugins.end()
    return {"frames": frames, "originals": originals}


@dataclass(frozen=True)
class _Shape:
    """Which frames of each setting the page shows."""

    indices: list[int]
    size: tuple[int, int]
    """Width and height of the part of a frame that is shown."""


def _shape(frames: int, settings: int, sequences: int, budget_bytes: int, wanted: Collection[int]) -> _Shape:
    """Choose the wanted frames, or as many as fit, and as large a part of them as the budget allows."""
    count = min(frames, max(1, min(_MOST_FRAMES, _VIEWS // max(1, settings * sequences))))
    spread = [int(frames * (place + 0.5) / count) for place in range(count)]
    indices = sorted({index for index in wanted if index < frames}) if wanted else spread
    pixels = budget_bytes / max(1, settings * len(indices)) / _BYTES_A_PIXEL
    scale = math.sqrt(pixels / (_LEAST_SIZE[0] * _LEAST_SIZE[1]))
    width, height = (
        max(least, min(most, int(scale * least))) for least, most in zip(_LEAST_SIZE, _MOST_SIZE, strict=True)
    )
    return _Shape(indices, (width, height))


def _marker(run: RunResult) -> PluginSetting | None:
    """The first evaluator of the run that marks frames and is installed."""
    here = {plugin.spec.name for plugin in installed().plugins("evaluator") if plugin.missing is None}
    settings = dict.fromkeys(result.cell.evaluator for result in run.results if result.cell.evaluator.name in here)
    return next((setting for setting in settings if "marks" in offers_of(run.plan, setting)), None)


_Names = list[tuple[str, str]]
"""Codecs and settings, the most important first."""


def _settings_by_rate(run: RunResult, entry: SequenceEntry, first: _Names) -> list[tuple[PluginSetting, float]]:
    """Codec settings except the baseline's by rising rate, those of unknown rate last, up to _SETTINGS_A_SEQUENCE."""
    settings = {(r.cell.codec.name, r.cell.codec.label): r.cell.codec for r in run.results}
    known = [
        (rate, settings[codec, label])
        for (sequence, codec, label), rate in run.rates.items()
        if sequence == entry.name and codec not in run.schema.baselines
    ]
    known.sort(key=lambda pair: (np.isnan(pair[0]), pair[0]))
    places = _select([(setting.name, setting.label) for _, setting in known], _SETTINGS_A_SEQUENCE, first)
    return [(known[place][1], known[place][0]) for place in places]


def _select(names: _Names, count: int, first: _Names) -> list[int]:
    """Select the places of `count` names, in order: those in `first`, and of the others some, spread evenly."""
    places = [names.index(name) for name in first if name in names][:count]
    others = [place for place in range(len(names)) if place not in places]
    spread = np.linspace(0, len(others) - 1, min(len(others), count - len(places))).round().astype(int)
    return sorted([*places, *(others[place] for place in spread)])


def _has_bitstreams(run: RunResult, entry: SequenceEntry, chosen: list[tuple[PluginSetting, float]]) -> bool:
    """Whether the run folder has a bitstream of a sequence."""
    store = Store(run.folder)
    return any(store.coded_path(coding_id(entry, setting)).exists() for setting, _ in chosen)


def _rate_words(run: RunResult, rate: float) -> str:
    """A rate with its unit; empty if unknown."""
    return "" if run.rate is None or np.isnan(rate) else f"{three_digits(rate * run.rate.factor)} {run.rate.unit}"


def _fit(views: list[_Views], budget_bytes: int, first: _Names) -> list[_Views]:
    """Select as many settings as the budget allows, see `_select`."""
    names = [(setting.name, setting.label) for setting, *_ in views]
    count = len(views)
    while count:
        selected = [views[place] for place in _select(names, count, first)]
        originals = sum(len(view.original) for view in selected[0][2])
        if originals + sum(view.weight_bytes for *_, frames in selected for view in frames) <= budget_bytes:
            return selected
        count -= 1
    return []


def _dataset_params(run: RunResult, entry: SequenceEntry, sequences_from: str | None) -> dict[str, Any] | None:
    """The parameters to open a sequence with; None, with a line in the log, if it may not be opened."""
    try:
        return openable_params(run.folder, entry, sequences_from)
    except (CodecbenchError, OSError) as error:
        log.warning("no images of %s: %s", entry.name, clean_line(str(error)))
        return None


def _views(
    run: RunResult,
    entry: SequenceEntry,
    params: dict[str, Any],
    setting: PluginSetting,
    shape: _Shape,
    marker: PluginSetting | None,
    plugins: Workbench,
) -> list[FrameView]:
    """Decode frames of a sequence under a setting; none, with a line in the log, if that fails."""
    job_id = coding_id(entry, setting)
    frames = []
    try:
        sequence = plugins.sequence(replace(entry, dataset=replace(entry.dataset, params=params)), MOST_BYTES)
        bitstreams = BitstreamFile(Store(run.folder).coded_path(job_id).absolute(), job_id)
        coded = CodedFrames(sequence, plugins.create(setting, job_id), bitstreams, WorkPosition())
        evaluator = plugins.create(marker, job_id) if marker else None
        for index in shape.indices:
            frame = coded.frame(index)
            frames.append(frame_view(frame, index, shape.size, evaluator.marks(frame) if evaluator else None))
    except (CodecbenchError, IndexError, OSError, ValueError) as error:
        operating_point = f"{setting.name} {setting.label}".strip()
        log.warning("no image of %s on %s: %s", operating_point, entry.name, clean_line(str(error)))
        return []
    finally:
        plugins.tidy()
    return frames


_WEBP_QUALITY: Final = 82
_DIFFERENCE_QUALITY: Final = 60
_SHOWN_PERCENT: Final = (1, 99)
_GAIN: Final = 4
"""Factor on differences of gray, which are shown around middle gray."""


def frame_view(coded: CodedFrame, index: int, size: tuple[int, int], marks: KeypointOverlay | None = None) -> FrameView:
    """Cut out the middle of a coded frame, at most `size` (width, height), unscaled. marks: of the whole frame."""
    top, left, height, width = _middle(coded.original.image, size)
    part = slice(top, top + height), slice(left, left + width)
    cut = [np.ascontiguousarray(image[part]) for image in (coded.original.image, coded.decoded)]
    original, decoded = cut if cut[0].dtype == np.uint8 else _in_8_bits(*cut)
    difference = 128 + _GAIN * (gray_from_image(decoded).astype(np.int16) - gray_from_image(original))
    kept, lost = ([], []) if marks is None else (_inside(marks, is_kept, part) for is_kept in (True, False))
    return FrameView(
        index,
        _uri(original, _WEBP_QUALITY),
        _uri(decoded, _WEBP_QUALITY),
        _uri(np.clip(difference, 0, 255).astype(np.uint8), _DIFFERENCE_QUALITY),
        width,
        height,
        kept,
        lost,
        "" if marks is None else marks.note,
    )


def _in_8_bits(original: Image, decoded: Image) -> list[Image]:
    """Show 16-bit images by the range of most of the original's pixels, without the extremes, often of no meaning."""
    inner = original[(original > 0) & (original < np.iinfo(original.dtype).max)]
    low, high = np.percentile(inner, _SHOWN_PERCENT) if inner.size else (0.0, 1.0)
    gain = 255.0 / max(high - low, 1.0)
    return [np.asarray(np.clip(gain * (image - low), 0, 255), np.uint8) for image in (original, decoded)]


def _middle(image: Image, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Top, left, height and width of the middle part of an image."""
    width, height = (min(limit, side) for limit, side in zip(size, image.shape[1::-1], strict=True))
    return (image.shape[0] - height) // 2, (image.shape[1] - width) // 2, height, width


def _inside(marks: KeypointOverlay, is_kept: bool, part: tuple[slice, slice]) -> list[int]:
    """The marks that are kept, or those that are lost, in pixels of a part of the frame."""
    rows, columns = part
    places = np.rint(marks.places[marks.kept == is_kept] - [columns.start, rows.start]).astype(int)
    limits = np.array([columns.stop - columns.start, rows.stop - rows.start])
    within: list[int] = places[((places >= 0) & (places < limits)).all(axis=1)].ravel().tolist()
    return within


def _uri(image: Image, quality: int) -> str:
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, buffer = cv2.imencode(".webp", stored, [cv2.IMWRITE_WEBP_QUALITY, quality])
    return "data:image/webp;base64," + base64.b64encode(buffer.tobytes()).decode()
