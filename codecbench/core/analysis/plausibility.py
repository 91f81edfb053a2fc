"""Which rows are lossless at so few bytes that the codec hardly sends the pictures: they carry a note."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from codecbench.core.analysis.table import CellResult

OF_A_CODEC: Final = 0.5
"""Share of another lossless codec's bytes below which a row is implausible: those of codecbench differ by less."""

OF_PNG: Final = 0.25
"""The same beside PNG, of whose bytes good codecs need a half on frames of a camera."""

_PLAIN: Final = 1 / 3
"""Share of the raw bytes below which PNGs are of drawn or empty pictures, on which honest codecs differ widely."""

_MEAN: Final = ("", "mean")


class _Lossless(NamedTuple):
    """A cell whose frames all came back as they were. bpp: bits per pixel. of_png: its bytes over those of PNGs."""

    result: CellResult
    bpp: float
    of_png: float


def with_doubts(results: Iterable[CellResult], stateless: Mapping[str, bool]) -> tuple[CellResult, ...]:
    """The results, with a note on those that are lossless at implausibly few bytes.

    stateless: by codec, whether it codes each picture on its own; those of which that is not known carry no note. A
    codec is compared with codecbench's others of its kind, because memory of a still scene honestly saves far more
    than a half. One without memory is compared with PNG where none of those in the run is smaller than PNG.
    """
    results = tuple(results)
    groups: dict[tuple[str, str, bool], list[_Lossless]] = defaultdict(list)
    for found in _lossless(results):
        cell = found.result.cell
        if cell.codec.name in stateless:
            groups[cell.sequence.name, cell.evaluator.title, stateless[cell.codec.name]].append(found)
    doubts = {
        id(found.result): doubt
        for (_, _, alone), group in groups.items()
        for found in group
        if (doubt := _doubt(found, group, beside_png=alone))
    }
    return tuple(
        replace(result, notes=(*result.notes, doubts[id(result)])) if id(result) in doubts else result
        for result in results
    )


def _lossless(results: Iterable[CellResult]) -> Iterator[_Lossless]:
    for result in results:
        means = {name: value for (name, stage, how), value in result.summaries.items() if (stage, how) == _MEAN}
        known = [metric for metric in result.metrics.values() if metric.name in means]
        kept = [means[metric.name] for metric in known if metric.role == "quality" and metric.unit == "dB"]
        spent = {metric.quantity: means[metric.name] for metric in known if metric.quantity}
        if kept and all(map(math.isinf, kept)) and {"per_pixel", "below_png"} <= spent.keys():
            yield _Lossless(result, spent["per_pixel"], 1 - spent["below_png"] / 100)


def _doubt(found: _Lossless, group: Iterable[_Lossless], *, beside_png: bool) -> str:
    own, sequence = found.result.cell.codec, found.result.cell.sequence
    if found.bpp < _PLAIN * 8 * sequence.channels * found.of_png:
        return ""
    known = [each for each in group if each.of_png < 1 and not each.result.cell.codec.distribution]
    others = [each for each in known if each.result.cell.codec.name != own.name]
    best = min(others, key=lambda each: each.bpp, default=None)
    if best is not None and found.bpp < OF_A_CODEC * best.bpp:
        share = f"{100 * found.bpp / best.bpp:.2g} % of the bytes of {best.result.cell.codec.name}"
        return f"implausible: lossless at {share}, the smallest other lossless codec of its kind on {sequence.name}"
    if best is None and beside_png and found.of_png < OF_PNG:
        return f"implausible: lossless at {100 * found.of_png:.2g} % of the bytes of PNG on {sequence.name}"
    return ""
