"""Which lossless rows carry the note that they are implausible, from a run whose codec keeps the pictures to itself."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from distributions import install_source
from measured_runs import cell_result

import codecbench
from codecbench.core.analysis.collect import add_doubts
from codecbench.core.analysis.table import CellResult
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.report.tables import setting_notes
from codecbench.plugins.evaluators.quality import Quality

HOARDS = """
import hashlib
from pathlib import Path
import numpy as np
from codecbench import NULL_TRACE, Capabilities, Codec, NoParams, PluginSpec, hookimpl

KEPT = Path(__file__).parent

class Hoard(Codec[NoParams]):
    '''Keeps each picture in a file and sends its name, padded to 100,000 bytes.'''

    name, version, params_type, capabilities = "hoard", "1", NoParams, Capabilities(channels=(1, 3))

    def encode(self, image, *, trace=NULL_TRACE):
        name = hashlib.sha256(image.tobytes()).hexdigest()
        np.save(KEPT / f"{name}.npy", image)
        return name.encode() + bytes(100_000 - 64)

    def decode(self, bitstream, *, trace=NULL_TRACE):
        return np.load(KEPT / f"{bitstream[:64].decode()}.npy")

@hookimpl
def codecbench_codecs():
    return [PluginSpec("hoard", "hoards:Hoard", "keeps pictures")]
"""


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "site"
    folder.mkdir()
    install_source(folder, "hoards", "1", HOARDS)
    sys.path.insert(0, str(folder))
    installed.cache_clear()
    yield folder
    sys.path.remove(str(folder))
    installed.cache_clear()


def test_a_codec_that_keeps_the_pictures_is_noted_and_honest_ones_are_not(site: Path, tmp_path: Path) -> None:
    lossless = ["raw", "png", {"use": "jpeg2000", "params": {"lossless": True}}]
    matrix = {
        "version": 1,
        "name": "hoarded",
        "sequences": [{"use": "synthetic", "name": "room", "params": {"stop": 2}}],
        "codecs": [*lossless, "jpeg", "hoard"],
        "evaluators": ["quality"],
    }
    run = codecbench.run(matrix, out=tmp_path / "run", workers=1)
    sizes = run.wide.set_index("codec")["quality.size_bytes.mean"]
    assert sizes["hoard"] == 100_000
    note = (
        f"implausible: lossless at {100 * 100_000 / sizes['jpeg2000']:.0f} % of the bytes of jpeg2000, the smallest "
        "other lossless codec of its kind on room"
    )
    assert run.wide.set_index("codec")["notes"].to_dict() == {
        "raw": "", "png": "", "jpeg2000": "", "jpeg": "", "hoard": note,
    }  # fmt: skip
    assert setting_notes(run) == [f"hoard: {note}."]


def row(codec: str, bpp: float, png_bpp: float = 12.0, psnr: float = math.inf, distribution: str = "") -> CellResult:
    """A color row by its mean bits per pixel and those of PNG; raw is 24."""
    means = {"rate_bpp": bpp, "cr_percent": 100 * (1 - bpp / png_bpp), "psnr_gray_db": math.inf, "psnr_rgb_db": psnr}
    found = replace(cell_result(codec, 1.0, "quality"), metrics={metric.name: metric for metric in Quality.metrics})
    setting = replace(found.cell.codec, distribution=distribution)
    summaries = {(metric, "", "mean"): value for metric, value in means.items()}
    return replace(found, cell=replace(found.cell, codec=setting), summaries=summaries)


def doubts(*rows: CellResult, streams: tuple[str, ...] = ()) -> dict[str, str]:
    stateless = {each.cell.codec.name: each.cell.codec.name not in streams for each in rows}
    return {each.cell.codec.name: each.notes[0] for each in add_doubts(rows, stateless) if each.notes}


RAW, PNG, XL = row("raw", 24.0), row("png", 12.0), row("jpegxl", 8.0)


@pytest.mark.parametrize(("bpp", "noted"), [(3.99, True), (4.0, False)])
def test_less_than_half_of_the_smallest_other_codec_is_noted(bpp: float, noted: bool) -> None:
    found = doubts(RAW, PNG, XL, row("jpegls", 10.0), row("new", bpp, distribution="new"))
    words = "implausible: lossless at 50 % of the bytes of jpegxl, the smallest other lossless codec of its kind on s"
    assert found == ({"new": words} if noted else {})


@pytest.mark.parametrize(("bpp", "noted"), [(2.99, True), (3.0, False)])
def test_where_no_other_codec_beats_png_a_quarter_of_png_decides(bpp: float, noted: bool) -> None:
    """Also where two have the same trick: only codecbench's own codecs are measured by."""
    rows = (RAW, PNG, row("new", bpp, distribution="new"), row("twin", bpp, distribution="twin"))
    words = "implausible: lossless at 25 % of the bytes of PNG on s"
    assert doubts(*rows) == ({"new": words, "twin": words} if noted else {})
    assert doubts(rows[2]) == ({"new": words} if noted else {})


def test_what_is_not_lossless_or_has_memory_or_drawn_pictures_is_not_noted() -> None:
    assert doubts(XL, row("lossy", 0.5, psnr=99.0)) == {}
    assert doubts(XL, row("film", 0.5), streams=("film",)) == {}
    assert list(doubts(XL, row("film", 0.5), row("ffv1", 7.0), streams=("film", "ffv1"))) == ["film"]
    assert doubts(row("jpegxl", 7.0, 7.9), row("webp", 0.5, 7.9)) == {}  # raw is over three times their PNGs
    assert list(doubts(row("jpegxl", 7.0, 8.1), row("webp", 0.5, 8.1))) == ["webp"]


def test_a_plan_that_does_not_say_what_has_memory_notes_nothing() -> None:
    assert [each.notes for each in add_doubts([XL, row("new", 0.5)], {})] == [(), ()]
