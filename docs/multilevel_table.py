"""The table of docs/multilevel.md: sizes of the multi-level codec in several ways, on a folder of pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from codecbench.core.report.tables import table
from codecbench.paper import facts
from codecbench.plugins.codecs.multilevel import Multilevel, describe


def sizes(folder: Path, heads: tuple[str, ...]) -> Iterator[str]:
    """Mean KiB a frame at the paper's QFs, how much of it is tables, and what other ways of coding change."""
    pictures = [cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB) for path in sorted(folder.glob("*.png"))]
    if not pictures:
        raise SystemExit(f"{folder} holds no PNG files")
    rows = []
    for qf, paper in facts.table("table3_multilevel").groupby("qf"):
        whole, tables = mean_kib(pictures, qf=qf)
        by_frequency, _ = mean_kib(pictures, qf=qf, scan="coefficient")
        changes = [
            mean_kib(pictures, qf=qf, levels=2)[0] / whole,
            mean_kib(pictures, qf=qf, levels=2, scan="coefficient")[0] / by_frequency,
            mean_kib(pictures, qf=qf, decoding="search")[0] / whole,
        ]
        sizes_kib = [f"{whole:.1f}", f"{tables:.1f}", f"{paper['l1_size_kb'].mean():g}"]
        rows.append([f"{qf}", *sizes_kib, *(f"{100 * (change - 1):+.1f} %" for change in changes)])
    yield f"Means of {len(pictures)} frames:\n"
    yield table(heads, rows)


def mean_kib(pictures: list[np.ndarray], **params: Any) -> tuple[float, float]:
    """Mean size of a frame in KiB, and that of its tables."""
    codec = Multilevel.create(**params)
    streams = [codec.encode(picture) for picture in pictures]
    tables = [sum(describe(stream).tables) for stream in streams]
    return sum(map(len, streams)) / len(streams) / 1024, sum(tables) / len(streams) / 1024
