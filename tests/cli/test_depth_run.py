"""Depth through the installed command: datasets, codecs and evaluators of ours and of others, tables and the report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from distributions import install_source
from installed_command import plain_place

DEEP = '''
import numpy as np

from codecbench import (
    NULL_TRACE, BitstreamError, Capabilities, Codec, FrameEvaluator, Measurement, Metric, NoParams, PluginSpec,
    check_image, hookimpl,
)


class Halves(Codec[NoParams]):
    """Drops the lowest of 16 bits."""

    name, version, params_type = "halves", "1", NoParams
    capabilities = Capabilities((1,), bits=(16,))

    def encode(self, image, *, trace=NULL_TRACE):
        image = check_image(image, (1,), (16,))
        return bytes(image.shape) + (image >> 1).tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        return np.frombuffer(bitstream[2:], np.uint16).reshape(tuple(bitstream[:2])) << 1

    def remark_at(self, bits):
        return f"keeps {bits - 1} bits"


class Farthest(FrameEvaluator[NoParams]):
    name, version, params_type = "farthest", "1", NoParams
    bits, needs = (16,), frozenset({"depth"})
    metrics = (Metric("farthest", "1", "neither", "largest decoded pixel"),)

    def evaluate(self, coded):
        yield Measurement("farthest", float(coded.decoded.max()))


@hookimpl
def codecbench_codecs():
    return [PluginSpec("halves", "codecbench_deep:Halves", "drops a bit")]


@hookimpl
def codecbench_evaluators():
    return [PluginSpec("farthest", "codecbench_deep:Farthest", "the largest pixel")]
'''
MATRIX = """
version: 1
name: deep
sequences: [{use: ramp, params: {frames: 2, bits: 16, unit_m: 0.001}}]
codecs: [rvl, halves, jpeg]
evaluators: [quality, depth, farthest, features]
run: {workers: 1}
"""


def test_depth_is_run_judged_and_shown(tmp_path: Path) -> None:
    place = plain_place(tmp_path)
    install_source(place.site, "codecbench-deep", "1", DEEP)
    (tmp_path / "deep.yaml").write_text(MATRIX)
    done = place.call("run", "deep.yaml")
    assert done.status == 0, done.output
    assert "halves: keeps 15 bits." in done.output
    assert "(mean error 0 mm), ≤ 1 required" in done.output
    assert "codec jpeg accepts gray or color frames; those of ramp are 16-bit gray" in done.output
    assert "evaluator features reads 8-bit frames; those of ramp are 16-bit gray" in done.output

    table = place.call("table", "runs/deep", "--all", "--format", "json", "--out", "table.json")
    assert table.status == 0, table.output
    rows = {(row["sequence"], row["codec"]): row for row in json.loads((tmp_path / "table.json").read_text())}
    ramp = rows["ramp", "halves"]
    assert ramp["depth.mean_error_mm.mean"] == pytest.approx(0.5)  # the pixels of the second frame are odd
    assert ramp["depth.worst_error_mm.max"] == 1.0
    assert ramp["farthest.farthest.mean"] == 120.0
    assert ramp["quality.psnr_gray_db.mean"] is None
    assert rows["ramp", "rvl"]["depth.noise_ratio.mean"] == 0.0
    report = place.call("report", "runs/deep")
    assert report.status == 0, report.output
    assert (tmp_path / "runs" / "deep" / "report" / "report.html").read_text().count("data:image/webp;base64,") >= 6
